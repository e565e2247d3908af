use sm2_proto::Instant;

use super::event_sets::LinkSets;

/// The parts of an interface's driver that one call lends to the methods of the interface and of its links.
pub(crate) struct Context<'a> {
    pub(crate) sets: &'a LinkSets,
    /// The time when the call began, for calls that drive, wait, take, publish, call or reply. Stale in all other
    /// calls.
    pub(crate) now: Instant,
    /// Whether a socket of the interface was read during this call, so that sleepers have to be
    /// woken.
    pub(crate) socket_read: bool,
}
