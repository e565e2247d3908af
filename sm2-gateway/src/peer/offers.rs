//! Offers to the peer. The session has room for a limited number; further offers wait.

use sm2_proto::gateway::{
    OfferId, Subject,
    schedule::SendQos,
    session::{self, Error, Misuse},
};

use super::{Peer, waiting_offers::WaitingOffer};
use crate::{clock::Now, tally::Whose};

impl Peer {
    pub(super) fn offer(&mut self, now: Now, number: OfferId, offer: WaitingOffer) {
        self.waiting_offers.0.insert(number, offer);
        self.make_offers(now);
    }

    /// Makes the waiting offers that have room, in the order of their numbers, since the
    /// session requires growing numbers.
    pub(super) fn make_offers(&mut self, now: Now) {
        while let Some((&offer, it)) = self.waiting_offers.0.first_key_value() {
            let command = session::Command::Offer {
                offer,
                subject: it.subject.clone(),
                path: it.path.clone(),
            };
            let taken = self.feed_session(now, session::Input::Command(command), None);
            if taken == Some(Err(Error::Misuse(Misuse::TooManyOffers))) {
                return;
            }
            let Some(WaitingOffer { subject, qos, .. }) = self.waiting_offers.0.remove(&offer)
            else {
                return;
            };
            if taken == Some(Ok(())) {
                // A latched message is published once, so it must not be lost.
                let is_reliable = subject.latched() > 0
                    || matches!(subject, Subject::Topic { reliable: true, .. });
                self.tally.open(Whose::Ours(offer), &subject);
                self.topics.add(offer, qos, is_reliable);
            }
        }
    }

    pub(super) fn change(&mut self, now: Now, offer: OfferId, qos: SendQos) {
        if let Some(it) = self.waiting_offers.0.get_mut(&offer) {
            it.qos = qos;
        }
        let (topics, mut outlet) = self.topics(now);
        topics.change(&mut outlet, offer, qos);
    }

    pub(super) fn withdraw(&mut self, now: Now, offer: OfferId) {
        if self.waiting_offers.0.remove(&offer).is_some() {
            return;
        }
        let command = session::ControlCommand::Unoffer { offer };
        self.session_command(now, session::Command::Control(command));
        let (topics, mut outlet) = self.topics(now);
        // Before the offer is closed, so that its dropped messages count under its name.
        topics.remove(&mut outlet, offer);
        self.tally.close(Whose::Ours(offer));
    }
}
