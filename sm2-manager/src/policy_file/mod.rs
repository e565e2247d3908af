//! Policy files: the access rights of a domain (SPEC section 15) as TOML without unknown keys.

mod domain;
mod error;
mod lines;
mod opened;
mod source;
mod toml_file;
mod warnings;

use std::path::{Path, PathBuf};

use sm2_proto::{
    Name,
    policy::{AccessPolicy, RuleId},
};

pub(crate) use self::domain::{check, of_domain};
pub use self::error::{PolicyFileError, PolicyValueError, PolicyWarning};
use self::{lines::Lines, opened::Opened, source::Source, toml_file::File};

/// A policy, and the place of its parts in the file.
#[derive(Clone, Debug)]
pub struct PolicyFile {
    /// The path of the file.
    pub path: PathBuf,
    /// The policy.
    pub policy: AccessPolicy,
    /// The lines of the tables, in the order of [`Tables`](sm2_proto::policy::Tables).
    lines: Lines,
}

impl PolicyFile {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// See [`PolicyFileError`].
    //= SM2-ACC-006
    pub fn load(path: &Path) -> Result<Self, PolicyFileError> {
        Self::parse(path, &Opened::at(path)?.text()?)
    }

    /// Checks the text of a file.
    ///
    /// # Errors
    /// See [`PolicyFileError`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, PolicyFileError> {
        let source = Source { path, text };
        let file: File = toml::from_str(text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            PolicyFileError::Toml {
                path: path.into(),
                line: source.line(&span),
                source: Box::new(error),
            }
        })?;
        let (tables, lines) = source.tables(&file)?;
        let policy = AccessPolicy::new(tables).map_err(|error| PolicyFileError::Policy {
            path: path.into(),
            line: lines.of_duplicate(&file).unwrap_or_else(|| lines.last()),
            source: error,
        })?;
        Ok(Self {
            path: path.into(),
            policy,
            lines,
        })
    }

    /// The line of a rule, from 1.
    #[must_use]
    pub fn rule_line(&self, rule: RuleId) -> Option<usize> {
        self.lines.rules.get(rule.0).copied()
    }

    /// The line of the table with this name, from 1.
    #[must_use]
    pub fn line_of(&self, table: &Name) -> Option<usize> {
        let tables = self.policy.tables();
        let rules = tables.rules.iter().map(|it| &it.name);
        let bindings = tables.bindings.iter().map(|it| &it.name);
        let exclusive = tables.exclusive.iter().map(|it| &it.name);
        let named = rules.chain(bindings).chain(exclusive);
        let mut named = named.zip(self.lines.all());
        named.find(|(name, _)| *name == table).map(|(_, line)| line)
    }

    /// The parts that probably do not do what their author expects.
    #[must_use]
    pub fn warnings(&self) -> Vec<PolicyWarning> {
        warnings::of(self.policy.tables(), &self.lines.rules)
    }
}
