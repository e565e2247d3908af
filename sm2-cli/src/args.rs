//! Arguments that several commands share, and the readers of their values.

use std::{path::PathBuf, time::Duration};

use clap::{Args, ValueEnum};
use sm2_proto::{Name, NameError};

use crate::time;

/// What every page of help about names says.
pub(crate) const GRAMMAR: &str =
    "segments of A-Z a-z 0-9 _ - joined by single /, at most 255 bytes";

/// Which domain a command talks to, and how long it tries.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Domain")]
pub(crate) struct Domain {
    /// The domain to talk to [default: $SM2_DOMAIN, else `default`]
    #[arg(long, value_name = "NAME")]
    pub(crate) domain: Option<String>,
    /// Its Manager's socket, wherever it is [default: $SM2_SOCKET, else the domain's]
    #[arg(long, value_name = "PATH", conflicts_with = "domain")]
    pub(crate) socket: Option<PathBuf>,
    /// How long the Manager may take to answer, such as 500ms
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    pub(crate) connect_timeout: Duration,
    /// Wait so long for a Manager that is not there yet, such as 30s
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    pub(crate) wait_manager: Option<Duration>,
}

/// How messages too large for a datagram are shared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Integrity {
    // Not documentation, which would make help a page long.
    // In memory that is used again.
    Pooled,
    // Each in memory of its own that nobody can change any more, its author neither.
    Sealed,
}

/// Reads a name as a person types it: one leading `/` is dropped.
pub(crate) fn name(text: &str) -> Result<Name, String> {
    Name::typed(text).map_err(|error| {
        let fault = match error {
            NameError::Empty => "it is empty".to_owned(),
            NameError::TooLong(len) => format!("it has {len} bytes"),
            NameError::EmptySegment(at) => format!("a segment is empty at byte {at}"),
            NameError::BadByte(at) => format!("byte {at} is none of these"),
        };
        format!("a name is {GRAMMAR}; {fault}")
    })
}

/// Reads a positive number that is not infinite.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("give a number above 0, such as 30 or 0.5".into()),
    }
}
