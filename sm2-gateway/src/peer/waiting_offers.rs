//! Offers for which the session has no room yet.

use std::collections::BTreeMap;

use sm2_proto::gateway::{Hop, OfferId, Subject, schedule::SendQos};

/// Offers for which the session has no room yet, by their numbers.
#[derive(Debug, Default)]
pub(super) struct WaitingOffers(pub(super) BTreeMap<OfferId, Offer>);

/// An offer of this side.
#[derive(Debug)]
pub(super) struct Offer {
    pub(super) subject: Subject,
    pub(super) path: Vec<Hop>,
    pub(super) qos: SendQos,
}
