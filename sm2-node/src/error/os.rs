//! The errors of the operating system behind those of this crate.

use std::io;

use sm2_io::DomainSocketError;
use sm2_io::counters::CounterError;
#[cfg(feature = "embedded-manager")]
use sm2_manager::StartError;

use super::{
    CallError, ConnectError, DeclareError, PublishError, QueryError, RecvError, ReloadError,
    ReplyError, StoreError, WaitError,
};

/// Implements `os_error` by the arms that find one.
macro_rules! os_errors {
    ($($error:ident { $($(#[$only:meta])? $pattern:pat => $found:expr,)+ })*) => {
        $(
            impl $error {
                /// The error of the operating system that caused this one; `None` if it did not refuse anything.
                /// `raw_os_error` of it is the `errno`.
                #[must_use]
                pub const fn os_error(&self) -> Option<&io::Error> {
                    match self {
                        $($(#[$only])? $pattern => $found,)+
                        _ => None,
                    }
                }
            }
        )*
    };
}

os_errors! {
    ConnectError {
        Self::NoManager { source, .. } | Self::Io { source, .. } => Some(source),
        Self::BackgroundThread(error) => Some(error),
        Self::DomainSocket(error) => of_domain_socket(error),
        #[cfg(feature = "embedded-manager")]
        Self::Manager(error) => of_manager(error),
    }
    DeclareError {
        Self::Reserve { source, .. } | Self::Lock { source, .. } => Some(source),
        Self::Io(error) => Some(error),
    }
    WaitError {
        Self::Io(error) => Some(error),
    }
    QueryError {
        Self::Io(error) => Some(error),
        Self::Counters(CounterError::Io { source, .. }) => Some(source),
    }
    ReloadError {
        Self::Query(error) => error.os_error(),
    }
    StoreError {
        Self::Io(error) => Some(error),
    }
    PublishError {
        Self::Io(error) => Some(error),
        Self::Store(error) => error.os_error(),
    }
    RecvError {
        Self::Map { source, .. } => Some(source),
        Self::Io(error) => Some(error),
    }
    CallError {
        Self::Map { source, .. } | Self::Io { source, .. } => Some(source),
        Self::Store(error) => error.os_error(),
    }
    ReplyError {
        Self::Store(error) => error.os_error(),
    }
}

const fn of_domain_socket(error: &DomainSocketError) -> Option<&io::Error> {
    match error {
        DomainSocketError::NotAListener { source } | DomainSocketError::Io { source, .. } => {
            Some(source)
        }
        _ => None,
    }
}

#[cfg(feature = "embedded-manager")]
const fn of_manager(error: &StartError) -> Option<&io::Error> {
    match error {
        StartError::DomainSocket(error) => of_domain_socket(error),
        StartError::NobodyServes { source, .. } | StartError::Io { source, .. } => Some(source),
        _ => None,
    }
}
