//! The errors of `sm2 param`.

use std::path::PathBuf;

use sm2_node::params::{FileError, WrongTable, WrongValue};
use sm2_proto::Name;

use crate::{ended::WRONG_USAGE, time::Span};

/// An error of `sm2 param`.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ParamError {
    /// The node has no parameters.
    #[error("node {node} has no parameters: its program declares none, or it is not ready yet")]
    None {
        /// The node.
        node: Name,
    },
    /// The node has no parameter of this name.
    #[error("node {node} has no parameter {name}{hint}")]
    Unknown {
        /// The node.
        node: Name,
        /// The name that was given.
        name: String,
        /// A similar name with punctuation, or an empty text.
        hint: String,
    },
    /// The node has not published its parameters in time.
    #[error(
        "the parameters of node {node} did not come within {timeout}: is its process stopped? \
         `sm2 topic info parameters/{node}` shows its links"
    )]
    NoTable {
        /// The node.
        node: Name,
        /// The time that was waited.
        timeout: Span,
    },
    /// The table of a node breaks the rules.
    #[error("node {node} publishes wrong parameters: {problem}")]
    WrongTable {
        /// The node.
        node: Name,
        /// The rule.
        problem: WrongTable,
    },
    /// A name has no value.
    #[error("parameter {name} has no value: give a value for each name, such as `{name} 1`")]
    NoValue {
        /// The name.
        name: String,
    },
    /// A value is not one of the parameter's type.
    #[error("parameter {name}: {reason}")]
    Value {
        /// The name.
        name: String,
        /// The fault.
        reason: WrongValue,
    },
    /// A file is not one of parameters.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file has nothing for the node.
    #[error("{} has no table for node {node}: write `[{node}]` above its values", path.display())]
    NotInFile {
        /// The file.
        path: PathBuf,
        /// The node.
        node: Name,
    },
    /// A value in a file is wrong.
    #[error("{}:{line}: {source}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The fault.
        r#source: Box<Self>,
    },
    /// The node refuses the values.
    #[error("node {node} refuses this: {reason}; nothing was set")]
    Refused {
        /// The node.
        node: Name,
        /// The reason of the node.
        reason: String,
    },
    /// The program has not decided in time.
    #[error(
        "node {node} has not decided within {timeout}, and nothing was set: its program does not look at changes, or \
         is stopped"
    )]
    NoAnswer {
        /// The node.
        node: Name,
        /// The time that was waited.
        timeout: Span,
    },
    /// The reply is not one of the service.
    #[error(
        "the reply of node {node} is not one to a set of parameters: is another program serving?"
    )]
    WrongReply {
        /// The node.
        node: Name,
    },
}

impl ParamError {
    /// The exit status.
    pub(crate) const fn status(&self) -> u8 {
        match self {
            Self::NoValue { .. } | Self::Value { .. } => WRONG_USAGE,
            _ => 1,
        }
    }
}
