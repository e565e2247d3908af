//! The outcome of a mutant.

use std::{fmt, time::Duration};

use crate::results;

/// How a check failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Killed {
    /// With a message that begins with these words.
    Said(String),
    /// It exceeded its time limit.
    Hung,
}

/// The verdict of the check on a mutant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The check failed, as it must.
    Killed(Killed),
    /// The check passed, or found another fault, with this message.
    Survived(Option<String>),
    /// The mutant does not compile, with this message.
    NotCompiled(String),
    /// The check also fails without the mutant, with this message.
    NoUse(String),
}

/// The outcome of one mutant.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The mutant.
    pub mutant: String,
    /// Its check.
    pub check: String,
    /// The verdict.
    pub verdict: Verdict,
    /// The time of the build and the check.
    pub took: Duration,
}

impl Outcome {
    /// True if the check found the mutant.
    #[must_use]
    pub const fn is_killed(&self) -> bool {
        matches!(self.verdict, Verdict::Killed(_))
    }

    /// The line for the file in `SM2_VERIFICATION_RESULTS`.
    #[must_use]
    pub fn result(&self) -> String {
        let covered = match &self.verdict {
            Verdict::Killed(Killed::Said(_)) => format!("killed by {}", self.check),
            Verdict::Killed(Killed::Hung) => format!("killed by {} (hung)", self.check),
            Verdict::Survived(_) => format!("survived {}", self.check),
            Verdict::NotCompiled(_) => "does not compile".to_owned(),
            Verdict::NoUse(_) => format!("{} fails without it", self.check),
        };
        let killed = self.is_killed();
        results::line("mutants", &self.mutant, killed, self.took, &covered)
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.took.as_secs_f64();
        write!(f, "{:<34} {seconds:5.1} s  ", self.mutant)?;
        match &self.verdict {
            Verdict::Killed(Killed::Said(said)) => {
                write!(f, "killed by {}: {said}", self.check)
            }
            Verdict::Killed(Killed::Hung) => write!(f, "killed by {}: it hung", self.check),
            Verdict::Survived(None) => write!(f, "SURVIVED {}", self.check),
            Verdict::Survived(Some(said)) => {
                write!(f, "SURVIVED {}, which said: {said}", self.check)
            }
            Verdict::NotCompiled(error) => write!(f, "DOES NOT COMPILE\n{error}"),
            Verdict::NoUse(said) => {
                write!(f, "{} FAILS WITHOUT THE MUTANT: {said}", self.check)
            }
        }
    }
}
