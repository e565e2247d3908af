//! Messages: numbered at their origin, accepted once, and passed on.

use bytes::Bytes;
use sm2_proto::{
    Instant,
    gateway::{GatewayId, OfferId, Subject, router::Source},
};

use super::{Hub, LocalCommand, Output};
use crate::{
    message::Message,
    peer::Command,
    tally::{Counts, Whose},
};

impl Hub {
    /// A publisher of the domain has published a message.
    pub(super) fn local_message(
        &mut self,
        now: Instant,
        subject: &Subject,
        published_at: Instant,
        payload: Bytes,
    ) {
        self.update_route(now, subject, Source::Local);
        let message = Message {
            sequence: self.sequences.next(subject),
            published_at,
            payload,
        };
        self.pass_on(subject, Source::Local, message);
    }

    /// A message of the domain was too long. It has a number as well, so that peers see a gap.
    pub(super) fn local_refused(&mut self, subject: &Subject) {
        self.sequences.next(subject);
        for (peer, offer) in self.router.takers(subject, Source::Local) {
            if let Some(it) = self.peers.get_mut(&peer) {
                it.tally.count(Whose::Ours(offer), |it| it.refused += 1);
            }
        }
    }

    /// A message of a peer has arrived.
    //= SM2-GWM-007
    pub(super) fn message(
        &mut self,
        now: Instant,
        peer: GatewayId,
        offer: OfferId,
        message: Message,
    ) {
        let offers = self.peers.get(&peer).map(|it| &it.offers);
        let Some((subject, origin)) = offers.and_then(|it| it.get(&offer)).cloned() else {
            return;
        };
        // The message may have been in flight when another offer replaced its offer.
        //= SM2-GWO-004
        //= SM2-GWR-004
        self.update_route(now, &subject, Source::Remote(origin.gateway));
        let key = (subject, origin.gateway);
        if self.routes.get(&key) != Some(&(peer, offer)) {
            return;
        }
        let routes = &self.routes;
        self.sequences.make_room(&key, |it| routes.contains_key(it));
        let (subject, _) = key;
        let Some(skipped) = self.sequences.take(&subject, origin, message.sequence) else {
            return;
        };
        if skipped > 0
            && let Some(it) = self.peers.get_mut(&peer)
        {
            // Saturates, since the peer chooses the numbers.
            let skip = |it: &mut Counts| it.skipped = it.skipped.saturating_add(skipped);
            it.tally.count(Whose::Theirs(offer), skip);
        }
        let payload = message.payload.clone();
        self.pass_on(&subject, Source::Remote(origin.gateway), message);
        self.outputs.push_back(Output::Local(LocalCommand::Publish {
            subject,
            origin: origin.gateway,
            payload,
        }));
    }

    fn pass_on(&mut self, subject: &Subject, source: Source, message: Message) {
        let takers: Vec<(GatewayId, OfferId)> = self.router.takers(subject, source).collect();
        for (peer, offer) in takers {
            let message = message.clone();
            self.tell(peer, Command::Message { offer, message });
        }
        self.latched.keep(subject, source, message);
    }

    /// A peer wants a topic, perhaps later than others: sends it the latched messages.
    //= SM2-GWM-009
    pub(super) fn replay(&mut self, peer: GatewayId, offer: OfferId) {
        let Some((subject, source)) = self.source(peer, offer) else {
            return;
        };
        for message in self.latched.messages(&subject, source) {
            self.tell(peer, Command::Message { offer, message });
        }
    }

    /// The gateway no longer wants a remote topic. When it wants the topic again, the latched
    /// messages are sent again.
    //= SM2-GWM-008
    pub(super) fn unused(&mut self, subject: &Subject, origin: GatewayId) {
        if subject.latched() > 0 {
            self.latched.forget(subject, Source::Remote(origin));
            self.sequences.forget(subject, origin);
        }
    }
}
