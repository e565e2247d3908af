//! Options that several commands share.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sm2_proto::gateway::SubjectKind;

use crate::domain::DomainLocation;

/// The domain of a command.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Domain")]
pub struct Domain {
    /// The domain to ask [default: $SM2_DOMAIN, else `default`]
    #[arg(long, value_name = "NAME")]
    domain: Option<String>,
    /// Its Manager's socket, wherever it is [default: $SM2_SOCKET, else the domain's]
    #[arg(long, value_name = "PATH", conflicts_with = "domain")]
    socket: Option<PathBuf>,
}

impl Domain {
    pub(super) fn location(&self) -> DomainLocation {
        match (&self.socket, &self.domain) {
            (Some(path), _) => DomainLocation::Socket(path.clone()),
            (None, Some(name)) => DomainLocation::Name(name.clone()),
            (None, None) => DomainLocation::Environment,
        }
    }
}

/// The kind of a name on the command line.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum Kind {
    Topic,
    Service,
}

impl From<Kind> for SubjectKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Topic => Self::Topic,
            Kind::Service => Self::Service,
        }
    }
}
