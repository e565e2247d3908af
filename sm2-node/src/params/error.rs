//! Parameters could not be declared or set.

use std::io;
use std::path::PathBuf;

use super::file::FileError;
use super::notation::WrongValue;
use super::refusal::{NameProblem, Refusal};
use crate::{DeclareError, PublishError};

/// The parameters of a node could not be declared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ParametersError {
    /// The node has parameters already.
    #[error("this node has declared its parameters already: add all of them to one builder")]
    Again,
    /// The name of a parameter is not legal.
    #[error("parameter {name:?}: {reason}")]
    Name {
        /// The name as the program gave it.
        name: String,
        /// The rule that it breaks.
        reason: NameProblem,
    },
    /// The program added two parameters with one name.
    #[error("the program adds parameter {name} twice: choose another name")]
    Twice {
        /// The name.
        name: String,
    },
    /// The program added too many parameters.
    #[error("the program adds {count} parameters, but at most {max} are possible", max = super::limits::PARAMETERS_MAX)]
    TooMany {
        /// The number of parameters.
        count: usize,
    },
    /// A description is too long.
    #[error("the description of parameter {name} has more than {max} bytes: shorten it", max = super::limits::TEXT_MAX)]
    Description {
        /// The name of the parameter.
        name: String,
    },
    /// A range is empty, its step is negative, or it is not finite.
    #[error(
        "the range of parameter {name} ({range}) has no values: swap its ends, or mend its step"
    )]
    Range {
        /// The name of the parameter.
        name: String,
        /// The range.
        range: super::range::Range,
    },
    /// A default is not legal, or all values together are too long.
    #[error("the program's parameters are not possible: {0}")]
    Default(Refusal),
    /// A file is not one of parameters.
    #[error(transparent)]
    File(#[from] FileError),
    /// The table of the node in a file has a name that is not a parameter of the node.
    #[error(
        "{}:{line}: node {node} has no parameter {name}: mend the name, or remove the line",
        path.display()
    )]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The node.
        node: String,
        /// The name in the file.
        name: String,
    },
    /// A value in a file is not one of the parameter's type.
    #[error("{}:{line}: parameter {name}: {reason}", path.display())]
    FileValue {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The name of the parameter.
        name: String,
        /// The fault.
        reason: WrongValue,
    },
    /// A value in a file may not be set.
    #[error("{}:{line}: {refusal}", path.display())]
    FileRefused {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The fault.
        refusal: Refusal,
    },
    /// The value of an environment variable is not one of the parameter's type.
    #[error("environment variable {variable}: parameter {name}: {reason}")]
    VariableValue {
        /// The variable.
        variable: String,
        /// The name of the parameter.
        name: String,
        /// The fault.
        reason: WrongValue,
    },
    /// The value of an environment variable may not be set.
    #[error("environment variable {variable}: {refusal}")]
    VariableRefused {
        /// The variable.
        variable: String,
        /// The fault.
        refusal: Refusal,
    },
    /// The value of an environment variable is not UTF-8.
    #[error("environment variable {variable} is not UTF-8: write it again")]
    VariableText {
        /// The variable.
        variable: String,
    },
    /// An environment variable stands for two parameters.
    #[error(
        "environment variable {variable} stands for the parameters {first} and {second}: set them in a file"
    )]
    VariableOfTwo {
        /// The variable.
        variable: String,
        /// One of the parameters.
        first: String,
        /// Another one.
        second: String,
    },
    /// The topic or the service of the parameters could not be declared.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// The parameters could not be published.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// The thread that serves the parameters could not be started.
    #[error(
        "cannot start the thread that serves the parameters ({0}): raise the limits of threads and files"
    )]
    Thread(io::Error),
}

/// A parameter could not be set. It has its value as before.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SetError {
    /// The value is not legal, or the parameter is read-only.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The new values could not be published.
    #[error(transparent)]
    Publish(#[from] PublishError),
}
