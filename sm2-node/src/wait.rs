//! How a subscriber, a client or a server waits.

use std::time::Duration;

/// What a thread does while it waits for a message, a request or a reply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wait {
    /// It sleeps; whoever sends wakes it with a system call. Costs nothing while nothing comes.
    #[default]
    Park,
    /// It looks again and again for so long, and then sleeps: for messages that follow each
    /// other closely, or that come at a known time.
    SpinThenPark(Duration),
    /// It looks again and again: the shortest delay, for a core of its own.
    Spin,
}
