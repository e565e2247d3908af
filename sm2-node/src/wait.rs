//! How a thread waits for messages.

use std::time::Duration;

/// How a thread waits for a message, a request or a reply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wait {
    /// Sleeps. The sender wakes the thread with a system call. Uses no processor time while no message comes.
    #[default]
    Park,
    /// Polls for this time, and then sleeps: for messages that arrive in quick succession or at known times.
    SpinThenPark(Duration),
    /// Polls all the time: the shortest delay, for a thread with its own core.
    Spin,
}
