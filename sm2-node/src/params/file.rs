//! Files of parameters: TOML with a table for each node.

use std::path::{Path, PathBuf};
use std::{fs, io};

use toml::de::{DeTable, DeValue};

use super::notation::{Literal, WrongValue};
use super::value::{Kind, Value};

/// The table of a file whose values are for all nodes that have such parameters.
pub const ALL_NODES: &str = "*";

/// A file of parameters.
///
/// Each table is for the node of its name. The table `"*"` is for all nodes, and has lower precedence. A table inside
/// of a node's table stands for the part of a name before a dot:
///
/// ```toml
/// ["*"]
/// frame = "base"                  # for each node that has this parameter
///
/// [lidar]
/// max_range = 30.0
/// filter.size = 3                 # the parameter `filter.size`
///
/// ["arm/left"]
/// joints = ["shoulder", "elbow"]
/// ```
#[derive(Clone, Debug)]
pub struct File {
    path: PathBuf,
    tables: Vec<NodeTable>,
}

/// The table of a node.
#[derive(Clone, Debug)]
struct NodeTable {
    node: String,
    values: Vec<FileValue>,
}

/// A value in a file.
#[derive(Clone, Debug)]
pub struct FileValue {
    /// The name of the parameter.
    pub name: String,
    /// The line of the file, from 1.
    pub line: usize,
    value: Literal,
}

/// A file is not one of parameters.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// It cannot be read.
    #[error("cannot read the parameters in {} ({source}): check the path and its permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// It is not TOML.
    #[error("{}:{line}: {reason}", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The fault.
        reason: String,
    },
    /// A value stands outside of the tables.
    #[error(
        "{}:{line}: {key} is outside of the table of a node: write `[NODE]` above it, such as `[lidar]`",
        path.display()
    )]
    NoTable {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The key.
        key: String,
    },
}

impl File {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// See [`FileError`].
    pub fn load(path: impl Into<PathBuf>) -> Result<Self, FileError> {
        let path = path.into();
        match fs::read_to_string(&path) {
            Ok(text) => Self::parse(path, &text),
            Err(source) => Err(FileError::Read { path, source }),
        }
    }

    /// Reads the text of a file. Errors name `path`.
    ///
    /// # Errors
    ///
    /// [`FileError::Toml`], [`FileError::NoTable`].
    pub fn parse(path: impl Into<PathBuf>, text: &str) -> Result<Self, FileError> {
        let path = path.into();
        let line = |at: usize| text.get(..at).unwrap_or("").matches('\n').count() + 1;
        let tables = DeTable::parse(text).map_err(|error| FileError::Toml {
            path: path.clone(),
            line: line(error.span().map_or(0, |it| it.start)),
            reason: error.message().to_owned(),
        })?;
        let mut file = Self {
            path,
            tables: Vec::new(),
        };
        for (key, value) in tables.into_inner() {
            let (at, node) = (key.span().start, key.into_inner().into_owned());
            let DeValue::Table(table) = value.into_inner() else {
                let (path, line) = (file.path, line(at));
                return Err(FileError::NoTable {
                    path,
                    line,
                    key: node,
                });
            };
            let mut values = Vec::new();
            flatten("", table, &line, &mut values);
            file.tables.push(NodeTable { node, values });
        }
        Ok(file)
    }

    /// The path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The nodes that have a table in the file, without [`ALL_NODES`].
    pub fn nodes(&self) -> impl Iterator<Item = &str> {
        let nodes = self.tables.iter().map(|it| it.node.as_str());
        nodes.filter(|it| *it != ALL_NODES)
    }

    /// The values in the table of this node, or of [`ALL_NODES`].
    pub fn values(&self, node: &str) -> impl Iterator<Item = &FileValue> {
        let tables = self.tables.iter().filter(move |it| it.node == node);
        tables.flat_map(|it| &it.values)
    }
}

impl FileValue {
    /// The value, for a parameter of this type.
    ///
    /// # Errors
    ///
    /// See [`WrongValue`].
    pub fn read(&self, kind: Kind) -> Result<Value, WrongValue> {
        kind.read(&self.value)
    }
}

/// Appends the values of a table, and of the tables in it, under their full names. The depth is limited by the parser.
fn flatten(
    prefix: &str,
    table: DeTable<'_>,
    line: &impl Fn(usize) -> usize,
    values: &mut Vec<FileValue>,
) {
    for (key, value) in table {
        let name = match prefix {
            "" => key.get_ref().to_string(),
            prefix => format!("{prefix}.{}", key.get_ref()),
        };
        let line_of_key = line(key.span().start);
        match value.into_inner() {
            DeValue::Table(inner) => flatten(&name, inner, line, values),
            value => values.push(FileValue {
                name,
                line: line_of_key,
                value: Literal::new(&value),
            }),
        }
    }
}
