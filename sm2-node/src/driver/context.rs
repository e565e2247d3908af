//! The parts of a node that one call lends to the methods of interfaces and links.

use sm2_proto::Instant;

use super::counters::Counting;
use super::event_sets::EventSets;

/// The parts of a node that one call lends to the methods of an interface and of its links.
pub(crate) struct Context<'a> {
    pub(crate) sets: &'a EventSets,
    pub(crate) buffer: &'a mut [u8],
    pub(crate) counting: &'a mut Counting,
    /// The time at which the call began, for calls that wait, take or publish. Stale in
    /// all other calls.
    pub(crate) now: Instant,
    /// Whether a socket of the interface was read during this call, so that sleepers have to be
    /// woken.
    pub(crate) stirred: bool,
}
