//! The parameters of a node as one value, and the rules for refusing a set. No I/O.

use std::collections::{HashMap, HashSet};

use serde::{Deserialize, Serialize};

use super::limits::{NAME_MAX, PARAMETERS_MAX, TABLE_MAX, TEXT_MAX, VALUE_MAX};
use super::range::Range;
use super::refusal::{NameProblem, Refusal, WrongTable, cut};
use super::value::{Kind, Value};
use crate::{Message, Schema};

/// All parameters of a node at one moment: the message of the topic `parameters/NODE`.
//= SM2-PRM-001
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Message)]
#[message(name = "sm2/Parameters", encoding = "postcard")]
pub struct Table {
    /// The number of this state: 1 when the node declares its parameters, and one more for each change.
    pub revision: u64,
    /// The time of the change, in nanoseconds since 1970 (UTC), by the wall clock.
    pub time_ns: u64,
    /// The parameters, in the order in which the program added them.
    pub parameters: Vec<Entry>,
}

/// A parameter in a [`Table`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Entry {
    /// The name: segments of `A-Z a-z 0-9 _ -`, joined by single `.`.
    pub name: String,
    /// The value.
    pub value: Value,
    /// The place that the value comes from.
    pub origin: Origin,
    /// The revision of the table when the value changed last.
    pub revision: u64,
    /// Whether the value cannot be set while the program runs.
    pub read_only: bool,
    /// The values that a number may have.
    pub range: Option<Range>,
    /// The purpose of the parameter, and its unit. May be empty.
    pub description: String,
}

/// The place that a value comes from. A later one in this list takes precedence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// The program's default.
    Default,
    /// A file of parameters.
    File,
    /// An environment variable.
    Environment,
    /// It was set while the program ran.
    Set,
}

impl Origin {
    /// `default`, `file`, `environment` or `set`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::File => "file",
            Self::Environment => "environment",
            Self::Set => "set",
        }
    }
}

/// A request to set parameters: all of them, or none. The request of the service `parameters/NODE`.
//= SM2-PRM-001
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Message)]
#[message(name = "sm2/SetParameters", encoding = "postcard")]
pub struct SetParameters {
    /// The new values, at most one for each parameter.
    pub parameters: Vec<Assignment>,
}

/// A new value of a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Assignment {
    /// The name of the parameter.
    pub name: String,
    /// Its new value.
    pub value: Value,
}

/// The reply of the service `parameters/NODE`.
//= SM2-PRM-001
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Message)]
#[message(name = "sm2/SetParametersResult", encoding = "postcard")]
pub struct SetParametersResult {
    /// Whether the parameters have the new values. Otherwise none of them has changed.
    pub successful: bool,
    /// Why they have not. Empty if they have.
    pub reason: String,
    /// The revision of the table after the request.
    pub revision: u64,
}

impl SetParametersResult {
    /// The reply to a request that was granted.
    pub(super) const fn granted(revision: u64) -> Self {
        let reason = String::new();
        Self {
            successful: true,
            reason,
            revision,
        }
    }

    /// The reply to a request that was refused. A reason that is too long is cut off.
    pub(super) fn refused(reason: String, revision: u64) -> Self {
        Self {
            successful: false,
            reason: cut(reason, TEXT_MAX),
            revision,
        }
    }
}

impl Entry {
    /// The type of the parameter.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        self.value.kind()
    }

    /// Checks whether the parameter may have this value.
    ///
    /// # Errors
    ///
    /// [`Refusal::WrongType`], [`Refusal::OutOfRange`], [`Refusal::TooLong`].
    //= SM2-PRM-003
    pub fn check(&self, value: &Value) -> Result<(), Refusal> {
        let name = || self.name.clone();
        if value.kind() != self.kind() {
            return Err(Refusal::WrongType {
                name: name(),
                expected: self.kind(),
                found: value.kind(),
            });
        }
        match self.range {
            Some(range) if !range.contains(value) => {
                let value = value.to_string();
                let name = name();
                return Err(Refusal::OutOfRange { name, value, range });
            }
            _ => {}
        }
        match encoded_len(value) {
            len if len > VALUE_MAX => Err(Refusal::TooLong { name: name(), len }),
            _ => Ok(()),
        }
    }
}

impl Table {
    /// The parameter of this name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Entry> {
        self.parameters.iter().find(|it| it.name == name)
    }

    /// The table after these values are set at `time_ns`; `None` if it stays as it is.
    ///
    /// # Errors
    ///
    /// [`Refusal`] for the first value that may not be set.
    //= SM2-PRM-002
    pub(super) fn set(
        &self,
        assignments: &[Assignment],
        time_ns: u64,
    ) -> Result<Option<Self>, Refusal> {
        let entries = self.parameters.iter().enumerate();
        let index: HashMap<_, _> = entries.map(|(at, it)| (it.name.as_str(), at)).collect();
        let mut named = HashSet::new();
        let mut changed = Vec::new();
        for Assignment { name, value } in assignments {
            let Some(&at) = index.get(name.as_str()) else {
                return Err(Refusal::unknown(name));
            };
            let (entry, name) = (&self.parameters[at], || name.clone());
            if !named.insert(at) {
                return Err(Refusal::Twice { name: name() });
            }
            if entry.read_only {
                return Err(Refusal::ReadOnly { name: name() });
            }
            entry.check(value)?;
            if entry.value != *value {
                changed.push((at, value));
            }
        }
        if changed.is_empty() {
            return Ok(None);
        }
        let mut next = self.clone();
        next.revision += 1;
        next.time_ns = time_ns;
        for (at, value) in changed {
            let entry = &mut next.parameters[at];
            entry.value = value.clone();
            entry.origin = Origin::Set;
            entry.revision = next.revision;
        }
        next.check_len()?;
        Ok(Some(next))
    }

    /// Checks the length of the encoded table.
    //= SM2-PRM-004
    pub(super) fn check_len(&self) -> Result<(), Refusal> {
        match encoded_len(self) {
            len if len > TABLE_MAX => Err(Refusal::TableTooLong { len }),
            _ => Ok(()),
        }
    }

    /// Checks a table that another process has sent.
    ///
    /// # Errors
    ///
    /// The rule that it breaks.
    //= SM2-PRM-005
    pub fn check(&self) -> Result<(), WrongTable> {
        let count = self.parameters.len();
        if count > PARAMETERS_MAX {
            return Err(WrongTable::TooMany { count });
        }
        let mut names = HashSet::new();
        for entry in &self.parameters {
            check_name(&entry.name).map_err(WrongTable::Name)?;
            let name = || entry.name.clone();
            if !names.insert(entry.name.as_str()) {
                return Err(WrongTable::Twice { name: name() });
            }
            if entry.description.len() > TEXT_MAX {
                return Err(WrongTable::Description { name: name() });
            }
            if entry.range.is_some_and(|it| !it.is_valid()) {
                return Err(WrongTable::Range { name: name() });
            }
            entry.check(&entry.value).map_err(WrongTable::Value)?;
        }
        Ok(())
    }
}

/// Checks the name of a parameter.
//= SM2-PRM-004
pub(super) fn check_name(name: &str) -> Result<(), NameProblem> {
    let is_legal = |it: char| it.is_ascii_alphanumeric() || it == '_' || it == '-';
    match name
        .split('.')
        .find(|it| it.is_empty() || !it.chars().all(is_legal))
    {
        _ if name.len() > NAME_MAX => Err(NameProblem::TooLong { len: name.len() }),
        Some(segment) => Err(NameProblem::Segment {
            segment: segment.to_owned(),
        }),
        None => Ok(()),
    }
}

/// The length of a value in its encoding, in bytes. No value of these types fails to encode.
fn encoded_len(value: &impl Serialize) -> usize {
    postcard::to_allocvec(value).map_or(usize::MAX, |it| it.len())
}
