//! The names of callbacks, for errors.

use std::fmt;
use std::panic::Location;

use sm2_proto::{Kind, Name};

use crate::driver::Condition;
use crate::wait_set::Source;

/// The source of a callback, and the place in the program where the callback was added.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Origin {
    source: CallbackSource,
    place: &'static Location<'static>,
}

/// The source of a callback.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum CallbackSource {
    /// The messages of a subscriber, or the requests of a server.
    Interface {
        /// The kind of interface.
        kind: Kind,
        /// The topic or service.
        name: Name,
    },
    /// The events of a publisher, subscriber, server or client.
    Events {
        /// The kind of interface.
        kind: Kind,
        /// The topic or service.
        name: Name,
    },
    /// The reply to a call.
    Call {
        /// The service.
        service: Name,
    },
    /// The sets of a synchronizer.
    Synchronizer {
        /// Its topics.
        topics: Vec<Name>,
    },
    /// The ticks of a timer.
    Timer,
    /// A descriptor of the program.
    Descriptor,
}

impl Origin {
    pub(super) const fn new(source: CallbackSource, place: &'static Location<'static>) -> Self {
        Self { source, place }
    }

    /// The source of the callback.
    #[must_use]
    pub const fn source(&self) -> &CallbackSource {
        &self.source
    }

    /// Where the program added the callback.
    #[must_use]
    pub const fn place(&self) -> &'static Location<'static> {
        self.place
    }
}

impl CallbackSource {
    /// The name of a part of a node.
    pub(super) fn of(source: &impl Source) -> Self {
        let interface = source.interface().lock();
        let contract = &interface.interface().contract;
        let (kind, name) = (contract.kind(), contract.name().clone());
        match source.condition() {
            Condition::Message | Condition::Room => Self::Interface { kind, name },
            Condition::Event => Self::Events { kind, name },
            Condition::Call(_) => Self::Call { service: name },
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (file, line) = (self.place.file(), self.place.line());
        write!(f, "the callback of {} ({file}:{line})", self.source)
    }
}

impl fmt::Display for CallbackSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Interface { kind, name } => write!(f, "{kind} {name}"),
            Self::Events { kind, name } => write!(f, "the events of {kind} {name}"),
            Self::Call { service } => write!(f, "a call of {service}"),
            Self::Synchronizer { topics } => {
                f.write_str("the synchronizer of ")?;
                for (at, topic) in topics.iter().enumerate() {
                    write!(f, "{}{topic}", if at == 0 { "" } else { ", " })?;
                }
                Ok(())
            }
            Self::Timer => f.write_str("a timer"),
            Self::Descriptor => f.write_str("a descriptor"),
        }
    }
}
