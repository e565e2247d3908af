//! The parts of a node that the methods of interfaces and links use.

use sm2_io::Epoll;
use sm2_proto::Instant;

use super::counters::Counting;

/// The parts of the node that the methods of a link use.
pub(crate) struct Tools<'a> {
    pub(crate) epoll: &'a Epoll,
    pub(crate) buffer: &'a mut [u8],
    pub(crate) counting: &'a mut Counting,
    /// The time at which the call began, for calls that wait, take or publish. Stale in
    /// all other calls.
    pub(crate) now: Instant,
    /// Whether a socket of the interface was read during this call, so that sleepers have to be
    /// woken.
    pub(crate) stirred: bool,
}
