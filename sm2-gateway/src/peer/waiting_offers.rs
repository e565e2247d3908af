//! Offers that the session has no room for yet.

use std::collections::BTreeMap;

use sm2_proto::gateway::{Hop, OfferId, Subject, schedule::SendQos};

/// Offers that the session has no room for yet, by their numbers.
#[derive(Debug, Default)]
pub(super) struct WaitingOffers(pub(super) BTreeMap<OfferId, WaitingOffer>);

/// An offer of this side that waits for room.
#[derive(Debug)]
pub(super) struct WaitingOffer {
    pub(super) subject: Subject,
    pub(super) path: Vec<Hop>,
    pub(super) qos: SendQos,
}
