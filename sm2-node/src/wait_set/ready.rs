//! The results of a wait set.

use crate::Tick;

/// Identifies a source of a [`WaitSet`](crate::WaitSet). No key is used twice in one set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Key(pub(super) u64);

/// A source of a [`WaitSet`](crate::WaitSet) that is ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Ready<T> {
    /// The tag that was added with the source.
    pub tag: T,
    /// The key of the source.
    pub key: Key,
    /// Why the source is ready.
    pub cause: Cause,
}

/// Why a source is ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// A publisher, subscriber, server or client has something: call its `try_…` method.
    Interface,
    /// A timer has ticked.
    Tick(Tick),
    /// A descriptor of the program is ready.
    Descriptor(Readiness),
}

/// The state of a descriptor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Readiness {
    /// Reading does not block. Also set after a hang-up or an error, which reading reports.
    pub readable: bool,
    /// Writing does not block.
    pub writable: bool,
}

/// The events of a descriptor to wait for. Hang-ups and errors are always reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Interest {
    /// A read does not block.
    Readable,
    /// A write does not block.
    Writable,
    /// A read or a write does not block.
    Both,
}

impl From<Interest> for sm2_io::Interest {
    fn from(interest: Interest) -> Self {
        match interest {
            Interest::Readable => Self::READABLE,
            Interest::Writable => Self::WRITABLE,
            Interest::Both => Self::BOTH,
        }
    }
}
