//! Errors of generating code.

use std::fmt;
use std::io;
use std::path::PathBuf;

use sm2_ros_idl::{FolderError, SetError, TypeName};

use crate::size::SIZE_MAX_BYTES;

/// Definitions that have no Rust types, or files that cannot be read or written.
///
/// `Debug` prints the same text as `Display`, because cargo shows the `Debug` text of the error that `main` of a build
/// script returns.
#[derive(thiserror::Error)]
pub enum Error {
    /// A definition cannot be read. The text has its path, and the line.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// A type is missing, or contains itself.
    #[error(transparent)]
    Set(#[from] SetError),
    /// The folder has no definitions.
    #[error(
        "{}: expected the folder of a package, with definitions in `msg`, `srv` or `action`",
        .0.display()
    )]
    NoDefinitions(PathBuf),
    /// Two packages have the same name.
    #[error("{}: the package {package} is there already", folder.display())]
    PackageTwice {
        /// The folder of the second one.
        folder: PathBuf,
        /// The name.
        package: String,
    },
    /// The name of a type does not begin with an upper-case letter, as ROS 2 demands.
    #[error("{0} has no Rust type: begin its name with an upper-case letter")]
    TypeName(TypeName),
    /// Messages of this type would need too much of the stack.
    #[error(
        "{0} would have {1} bytes on the stack, {SIZE_MAX_BYTES} at most: use sequences instead of large arrays"
    )]
    TooLarge(TypeName, usize),
    /// Two types, or a type and a service, have the same name in Rust.
    #[error("{first} and {second} would both be {rust} in Rust: rename one of them")]
    TypeTwice {
        /// One type.
        first: TypeName,
        /// The other one.
        second: TypeName,
        /// The name in Rust.
        rust: String,
    },
    /// A constant or a default value does not fit its type.
    #[error("{}{name}: {value} is not a value of the type {ty}", prefix(.place.as_ref()))]
    Value {
        /// The file and the line, from 1.
        place: Option<(PathBuf, usize)>,
        /// The constant or field, behind the type that has it.
        name: String,
        /// The type of the constant or field.
        ty: String,
        /// The value, as the definition writes it.
        value: String,
    },
    /// The path of a Rust module cannot be parsed.
    #[error("{0:?} is not the path of a Rust module, such as `::my_crate::ros`")]
    Path(String),
    /// There is no folder for the generated file.
    #[error("OUT_DIR is not set: call this from build.rs, or set `Builder::out_dir`")]
    NoOutDir,
    /// The generated file cannot be written.
    #[error("{}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// The generated code is not Rust code: a mistake of this crate.
    #[error("the generated code cannot be parsed: {0}")]
    Code(syn::Error),
}

fn prefix(place: Option<&(PathBuf, usize)>) -> String {
    place.map_or_else(String::new, |(path, line)| {
        format!("{}: line {line}: ", path.display())
    })
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}
