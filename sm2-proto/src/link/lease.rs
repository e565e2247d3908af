use crate::{Instant, LeaseWatch};

/// The state of a topic's link for liveliness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Lease {
    /// Of a receiver that demands a lease, from the time at which the link opened.
    pub(super) watch: Option<LeaseWatch>,
    /// Of a sender: the time of an assertion for which `poll` has to return ALIVE.
    pub(super) due: Option<Instant>,
    /// Of a sender: the time of the newest assertion that came too soon after the last ALIVE.
    pub(super) held: Option<Instant>,
    /// Of a sender: the time from which on there may be another ALIVE.
    pub(super) next: Instant,
    /// Of a receiver: the time in the ALIVE that came with the present input.
    pub(super) came: Option<Instant>,
}
