//! The rules, while there may be offers that they deny.

use std::sync::Arc;

use sm2_proto::gateway::{Direction, GatewayId, Rules};

use crate::tally::{Tally, Whose};

/// The rules, until all offers that they deny are withdrawn.
#[derive(Debug)]
pub(super) struct Gate {
    pub(super) rules: Arc<Rules>,
    pub(super) peer: GatewayId,
}

impl Gate {
    /// True if the rules deny the subject of an offer.
    pub(super) fn denies(&self, tally: &Tally, offer: Whose) -> bool {
        let direction = match offer {
            Whose::Ours(_) => Direction::Out,
            Whose::Theirs(_) => Direction::In,
        };
        let key = tally.key(offer);
        key.is_some_and(|(kind, name)| !self.rules.allow(*kind, name, direction, &self.peer))
    }
}
