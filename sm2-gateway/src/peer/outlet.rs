//! The place where the payloads of a peer are written.

use quinn_proto::Connection;
use sm2_proto::{Instant, gateway::OfferId};

use super::{gate::Gate, unacked::Unacked};
use crate::tally::{Tally, Whose};

/// The connection that payloads are written to, and the counters that record them.
pub(super) struct Outlet<'a> {
    pub(super) now: Instant,
    pub(super) connection: &'a mut Connection,
    pub(super) tally: &'a mut Tally,
    pub(super) unacked: &'a mut Unacked,
    /// The rules, until all offers that they deny are withdrawn.
    pub(super) gate: Option<&'a Gate>,
}

impl Outlet<'_> {
    /// True if other rules deny the offer.
    pub(super) fn denies(&self, offer: OfferId) -> bool {
        let offer = Whose::Ours(offer);
        self.gate.is_some_and(|it| it.denies(self.tally, offer))
    }
}
