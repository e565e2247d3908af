//! `mutants.toml`: the faults, and the check that must find each.

use std::{
    fmt, fs,
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::MutantsError;

/// The path of the list, below the root of the workspace.
const FILE: &str = "verification/mutants.toml";

/// All mutants, in the order in which they are made.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Catalogue {
    /// The mutants; those of one file are adjacent, which builds faster.
    #[serde(rename = "mutant")]
    pub mutants: Vec<Mutant>,
}

/// One fault.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mutant {
    /// The name.
    pub name: String,
    /// The fault, in one sentence.
    pub breaks: String,
    /// The properties of PROPERTIES.md that the fault breaks.
    pub properties: Vec<String>,
    /// The file, below the root of the workspace.
    pub file: PathBuf,
    /// The text, which occurs exactly once in the file.
    pub from: String,
    /// The replacement.
    pub to: String,
    /// The check that must find it.
    pub check: Check,
    /// True if quick runs leave it out, so that they need few builds.
    #[serde(default)]
    pub full: bool,
}

/// A check that finds a mutant by failing.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Check {
    /// A Kani harness of `sm2-proto`, as the stand-in runs it.
    Harness {
        /// Its name in PROPERTIES.md.
        name: String,
    },
    /// A scope of the model.
    Model {
        /// Its name.
        scope: String,
        /// The property that must fail in the scope; other counts are not enough.
        property: String,
    },
    /// One test.
    Test {
        /// The package.
        package: String,
        /// `lib`, or the file below `tests` without its ending.
        target: String,
        /// The path of the function.
        test: String,
    },
}

/// A mutant that cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{mutant}: {} has its text {count} times, and must have it once: mend {FILE}",
    file.display()
)]
pub struct Gap {
    /// Its name.
    pub mutant: String,
    /// Where the text should be.
    pub file: PathBuf,
    /// The number of occurrences.
    pub count: usize,
}

impl Catalogue {
    /// Reads the list of the workspace at `root`.
    ///
    /// # Errors
    ///
    /// The list is missing or invalid.
    pub fn load(root: &Path) -> Result<Self, MutantsError> {
        let path = root.join(FILE);
        let text = fs::read_to_string(&path).map_err(MutantsError::file(&path))?;
        toml::from_str(&text).map_err(|source| MutantsError::Catalogue { path, source })
    }

    /// The mutant of that name.
    #[must_use]
    pub fn named(&self, name: &str) -> Option<&Mutant> {
        self.mutants.iter().find(|it| it.name == name)
    }

    /// The mutants whose text is not exactly once in the workspace at `root`.
    ///
    /// # Errors
    ///
    /// One of their files cannot be read.
    pub fn gaps(&self, root: &Path) -> Result<Vec<Gap>, MutantsError> {
        let mut gaps = Vec::new();
        for mutant in &self.mutants {
            let path = root.join(&mutant.file);
            let source = fs::read_to_string(&path).map_err(MutantsError::file(&path))?;
            gaps.extend(mutant.apply(&source).err());
        }
        Ok(gaps)
    }
}

impl Mutant {
    /// The source with the fault in it.
    ///
    /// # Errors
    ///
    /// The text is not exactly once there.
    pub fn apply(&self, source: &str) -> Result<String, Gap> {
        match source.matches(&self.from).count() {
            1 => Ok(source.replace(&self.from, &self.to)),
            count => Err(Gap {
                mutant: self.name.clone(),
                file: self.file.clone(),
                count,
            }),
        }
    }
}

impl Check {
    /// The folder of its package, below the root of the workspace.
    #[must_use]
    pub fn folder(&self) -> &Path {
        Path::new(match self {
            Self::Harness { .. } => "sm2-proto",
            Self::Model { .. } => "verification",
            Self::Test { package, .. } if package == "sm2-tests" => "tests",
            Self::Test { package, .. } => package,
        })
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Harness { name } => f.write_str(name),
            Self::Model { scope, property } => write!(f, "model {scope}, {property}"),
            Self::Test {
                package,
                target,
                test,
            } => write!(f, "{package}, {target}, {test}"),
        }
    }
}
