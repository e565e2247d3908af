//! The errors of configurations.

use std::{io, path::PathBuf};

use sm2_proto::{
    Name, WrongText,
    gateway::{GatewayIdError, schedule::PRIORITY_MAX},
};

use crate::{address::AddressError, peer::Limit};

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
    /// The file is not TOML, or a key is unknown, missing or of the wrong type.
    #[error("{path}:{line}: {}", .source.message())]
    Toml {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The error of the parser.
        r#source: Box<toml::de::Error>,
    },
    /// A value is not allowed.
    #[error("{path}:{line}: {source}")]
    Value {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The error in the value.
        r#source: ConfigValueError,
    },
}

/// Why a value of a configuration was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigValueError {
    /// `name` is not a name, or `names` of a rule is not a pattern.
    #[error(transparent)]
    Text(#[from] WrongText),
    /// `listen` is not an address with a port.
    #[error("`{text}` is not an address with a port, such as 192.0.2.1:7633 or [fe80::1%2]:7633")]
    Listen {
        /// The text.
        text: String,
    },
    /// The file has both `domain` and `socket`.
    #[error("`domain` and `socket` exclude each other: remove one of them")]
    DomainAndSocket,
    /// Two peers have the same name.
    #[error("there are two peers of the name {name}: rename one of them")]
    DuplicateName {
        /// The name.
        name: Name,
    },
    /// Two peers have the same id.
    #[error("{other} has the same id: remove one of the two peers")]
    DuplicateId {
        /// The name of the other peer.
        other: Name,
    },
    /// The id of a peer is not an id.
    #[error("{0}; `sm2 gateway id` prints it at the peer")]
    Id(GatewayIdError),
    /// An address of a peer is neither an address nor the name of a host.
    #[error("`{text}` {source}")]
    Address {
        /// The text.
        text: String,
        /// The form that an address must have.
        r#source: AddressError,
    },
    /// A rule names a peer that no `[[peer]]` before it has.
    #[error("no [[peer]] of this file has the name `{text}`: add it with `sm2 gateway trust`")]
    UnknownPeer {
        /// The text.
        text: String,
    },
    /// A limit is 0 or too large.
    #[error("`{}` is {value}: give 1 to {}", .limit.name(), .limit.most())]
    Limit {
        /// The limit.
        limit: Limit,
        /// Its value.
        value: u64,
    },
    /// A limit exceeds that of a sum that contains its bytes: it could never be reached.
    #[error("`{}` is {value}: give at most {most}, the value of `{}`, or raise that one", .limit.name(), .whole.name())]
    LimitAboveWhole {
        /// The limit.
        limit: Limit,
        /// Its value.
        value: u64,
        /// The limit of the sum.
        whole: Limit,
        /// The value of that one.
        most: u64,
    },
    /// The priority of a rule is too high.
    #[error("a priority is 0 to {PRIORITY_MAX}")]
    Priority,
}
