//! Arguments that several commands share, and the parsers of their values.

use std::{path::PathBuf, time::Duration};

use clap::{Args, ValueEnum};
use sm2_proto::{Name, NameError};

use crate::time;

/// The rule for names, as errors state it.
pub(crate) const GRAMMAR: &str =
    "segments of A-Z a-z 0-9 _ - joined by single /, at most 255 bytes";

/// The options that choose a domain, and the timeouts for its Manager.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Domain")]
pub(crate) struct Domain {
    /// The domain to talk to [default: $SM2_DOMAIN, else `default`]
    #[arg(long, value_name = "NAME")]
    pub(crate) domain: Option<String>,
    /// The socket of the Manager [default: $SM2_SOCKET unless --domain is given, else the domain's]
    #[arg(long, value_name = "PATH", conflicts_with = "domain")]
    pub(crate) socket: Option<PathBuf>,
    /// The timeout for answers of the Manager, such as 500ms
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    pub(crate) connect_timeout: Duration,
    /// Wait for a Manager that does not run yet, at most for this time, such as 30s
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    pub(crate) wait_manager: Option<Duration>,
}

/// The kind of shared memory for messages that are too large for a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Integrity {
    // These are not doc comments: clap would add them to the help.
    // Memory that is reused.
    Pooled,
    // New memory for each message, which nobody can change after publishing, not even the publisher.
    Sealed,
}

/// A builder with the setting of an option, if the option was given.
pub(crate) fn with_option<B, T>(builder: B, option: Option<T>, set: impl FnOnce(B, T) -> B) -> B {
    match option {
        Some(value) => set(builder, value),
        None => builder,
    }
}

/// Parses a name from the command line. One leading `/` is dropped.
pub(crate) fn name(text: &str) -> Result<Name, String> {
    Name::typed(text).map_err(|error| {
        let fault = match error {
            NameError::Empty => "it is empty".to_owned(),
            NameError::TooLong(len) => format!("it has {len} bytes"),
            NameError::EmptySegment(at) => format!("a segment is empty at byte {at}"),
            NameError::BadCharacter { character, .. } => format!("{character:?} is none of these"),
        };
        format!("a name is {GRAMMAR}; {fault}")
    })
}

/// Parses a finite number above zero.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("give a number above 0, such as 30 or 0.5".into()),
    }
}

/// Parses the speed of a replay: 0 or more.
pub(crate) fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if rate.is_finite() && rate >= 0.0 => Ok(rate),
        _ => Err("give a factor of 0 or more, such as 2 or 0.5".into()),
    }
}
