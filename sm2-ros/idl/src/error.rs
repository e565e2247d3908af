//! Errors of reading definitions and of combining them.

use std::io;
use std::path::PathBuf;

use crate::{NameError, TypeName};

/// A line that is not part of a definition.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {reason}")]
pub struct DefinitionError {
    /// The number of the line, from 1.
    pub line: usize,
    /// The rule that the line breaks.
    pub reason: Reason,
}

/// The rule that a line breaks.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// A type without a name behind it.
    #[error("expected a type and a name, such as `float64 x`")]
    Name,
    /// A name with illegal characters.
    #[error("{0:?} is not the name of a field or constant: use letters, digits and `_`")]
    IllegalName(String),
    /// Two fields, or two constants, have this name.
    #[error("the name {0} is there already")]
    NameTwice(String),
    /// The type does not exist.
    #[error(transparent)]
    Type(#[from] NameError),
    /// A limit is not a number from 1 to 4294967295.
    #[error("{0:?} is not a number of values or bytes: write a number from 1 to 4294967295")]
    Limit(String),
    /// A constant of a type that constants cannot have.
    #[error("a constant is a number, a boolean or a string")]
    ConstantType,
    /// Nothing follows the `=` of a constant.
    #[error("a constant has a value behind `=`")]
    ConstantValue,
    /// The number of `---` lines does not fit the kind.
    #[error("a definition of this kind has {expected} lines `---`, not {found}")]
    Sections {
        /// The number that the kind requires.
        expected: usize,
        /// The number of lines in the text.
        found: usize,
    },
    /// A line `===` is not followed by `MSG: package/Name`.
    #[error("expected `MSG: package/Name` after a line of `=`")]
    Header,
}

/// A type that a set does not have, or cannot have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SetError {
    /// The type, or one that it refers to, is missing.
    #[error("{user} refers to {missing}, which is not defined: add the definitions of its package")]
    Missing {
        /// The type that refers to it.
        user: TypeName,
        /// The type that is missing.
        missing: TypeName,
    },
    /// The type is not in the set.
    #[error("{0} is not defined: add the definitions of its package")]
    Unknown(TypeName),
    /// A type contains itself.
    #[error("{0} contains itself, so no message of it has an end")]
    Cycle(TypeName),
    /// Types are nested too deeply.
    #[error("{0} is nested more than 64 deep")]
    TooDeep(TypeName),
}

/// A folder of definitions that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder or a file cannot be read.
    #[error("{}: {error}", path.display())]
    Io {
        /// The folder or file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// A file is not a definition.
    #[error("{}: {error}", path.display())]
    Definition {
        /// The file.
        path: PathBuf,
        /// The error.
        error: DefinitionError,
    },
    /// A path has no legal package or type name.
    #[error("{}: {error}", path.display())]
    Name {
        /// The file.
        path: PathBuf,
        /// The error.
        error: NameError,
    },
}
