//! The errors of `sm2 up`.

use std::{io, path::PathBuf};

use sm2_node::params::FileError;

use crate::{ended::WRONG_USAGE, time::Span};

/// The robot was not started.
#[derive(Debug, thiserror::Error)]
pub(crate) enum UpError {
    /// The file cannot be read.
    #[error("cannot read {} ({source}): name a file of programs, or make one with `sm2 new`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// A place of the file is wrong.
    #[error("{}:{line}:{column}: {fault}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The character of the line, from 1.
        column: usize,
        /// The fault.
        fault: Box<Fault>,
    },
    /// The Manager that was started does not serve.
    #[error(
        "the Manager does not serve after {0}: see its lines above, or start one with `sm2 manager`"
    )]
    NoManager(Span),
    /// The Manager that was started has ended.
    #[error("the Manager has ended: see its lines above")]
    ManagerEnded,
    /// No folder for units is known.
    #[error("neither $XDG_CONFIG_HOME nor $HOME is set: name the folder, such as --systemd=units")]
    NoUnitFolder,
    /// A unit would replace a file of somebody else.
    #[error(
        "{} exists, and `sm2 up --systemd` has not written it: remove it, or name another folder", path.display()
    )]
    ForeignUnit {
        /// The file.
        path: PathBuf,
    },
}

impl UpError {
    /// The exit status: 2 for a wrong file, 1 for any other error.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Read { .. } | Self::Wrong { .. } | Self::NoUnitFolder => WRONG_USAGE,
            _ => 1,
        }
    }
}

/// A fault in the file.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Fault {
    /// The file is not TOML, or a key is unknown, missing or of the wrong type.
    #[error("{}", .0.replace('\n', ", "))]
    Toml(String),
    /// There is no program.
    #[error("the file has no program: add a table such as `[program.lidar]` with its `command`")]
    NoProgram,
    /// The name of a program cannot be used.
    #[error("a program's name has 1 to 64 characters of A-Z a-z 0-9 _ -: rename this one")]
    Name,
    /// The name of a program is that of the Manager.
    #[error(
        "`manager` is the name of the Manager that `sm2 up` starts: rename this program, or write `manager = false`"
    )]
    ManagerName,
    /// The command is empty.
    #[error("the command is empty: name a program")]
    EmptyCommand,
    /// The command has an open quote.
    #[error(
        "a quote or a backslash at the end of the command is open: close it, or give a list of words"
    )]
    OpenQuote,
    /// A word of a command or variable cannot be passed to a program.
    #[error("a text for a program has no character 0: remove it")]
    Zero,
    /// There is no such program.
    #[error(
        "there is no program {0} that this user may execute: build or install it, or correct `command`"
    )]
    NoSuchProgram(String),
    /// The directory does not exist.
    #[error("{} is no directory: make it, or correct `directory`", .0.display())]
    NoDirectory(PathBuf),
    /// The file of parameters is wrong.
    #[error("{0}")]
    Params(FileError),
    /// The name of an environment variable.
    #[error("`{0}` is no name of an environment variable: it is empty, or has a `=`")]
    Variable(String),
    /// An expression of `after` is wrong.
    #[error("{0} (`sm2 wait --help` has the form)")]
    Expression(String),
    /// A time is wrong.
    #[error("{0}")]
    Time(String),
}
