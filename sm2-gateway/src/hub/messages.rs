//! Messages on their way: numbered at their origin, taken once, passed on.

use std::collections::BTreeMap;

use bytes::Bytes;
use sm2_proto::{
    Instant,
    gateway::{GatewayId, Hop, OfferId, Subject, router::Source},
};

use super::{Hub, LocalCommand, Output, latched::Latched};
use crate::{
    message::Message,
    peer::Command,
    tally::{Counts, Whose},
};

/// Of so many subjects and origins it is remembered what came, at least.
const SEEN_LEAST: usize = 16_384;

/// What was numbered, and what was seen.
#[derive(Debug, Default)]
pub(super) struct Messages {
    /// The last number of each subject of this domain.
    last: BTreeMap<Subject, u64>,
    /// What was taken last, of each origin.
    seen: BTreeMap<(Subject, GatewayId), Seen>,
    pub(super) latched: Latched,
}

/// The last message that was taken.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    epoch: u64,
    sequence: u64,
    /// Whether it was wanted ever since: what was published meanwhile is not missing.
    is_followed: bool,
}

impl Messages {
    pub(super) fn remembered(&self) -> usize {
        self.seen.len()
    }

    /// If it is newer than all that were taken from there: how many were left out in between.
    //= SM2-GWM-007
    fn take(&mut self, subject: &Subject, origin: Hop, sequence: u64) -> Option<u64> {
        let seen = self.seen.entry((subject.clone(), origin.gateway));
        let last = seen.or_default();
        let epoch = origin.epoch;
        if (epoch, sequence) <= (last.epoch, last.sequence) {
            return None;
        }
        let skipped = match last.is_followed && epoch == last.epoch {
            true => sequence - last.sequence - 1,
            false => 0,
        };
        *last = Seen {
            epoch,
            sequence,
            is_followed: true,
        };
        Some(skipped)
    }

    /// It is wanted from now on: what its origin has published before is not missing.
    pub(super) fn wanted(&mut self, subject: &Subject, origin: GatewayId) {
        if let Some(it) = self.seen.get_mut(&(subject.clone(), origin)) {
            it.is_followed = false;
        }
    }

    /// What comes from there is not taken any more. What is latched may come again when it is.
    //= SM2-GWM-007
    pub(super) fn unused(&mut self, subject: &Subject, origin: GatewayId) {
        if subject.latched() > 0 {
            self.latched.forget(subject, Source::Remote(origin));
            self.seen.remove(&(subject.clone(), origin));
        }
    }
}

impl Hub {
    /// Somebody in the domain published.
    pub(super) fn local_message(&mut self, subject: &Subject, published: Instant, payload: Bytes) {
        let last = self.messages.last.entry(subject.clone()).or_insert(0);
        *last += 1;
        let sequence = *last;
        let message = Message {
            sequence,
            published,
            payload,
        };
        self.pass_on(subject, Source::Local, message);
    }

    /// A peer sent a message.
    //= SM2-GWM-005
    pub(super) fn message(&mut self, peer: GatewayId, offer: OfferId, message: Message) {
        let offers = self.peers.get(&peer).map(|it| &it.offers);
        let Some((subject, origin)) = offers.and_then(|it| it.get(&offer)).cloned() else {
            return;
        };
        // It may have been on its way here when its offer went out of use.
        //= SM2-GWO-004
        //= SM2-GWR-004
        let key = (subject, origin.gateway);
        if self.calls.routes.get(&key) != Some(&(peer, offer)) {
            return;
        }
        if self.messages.seen.len() >= SEEN_LEAST && !self.messages.seen.contains_key(&key) {
            // A peer is not to fill the memory with origins that it invents.
            let routes = &self.calls.routes;
            self.messages.seen.retain(|it, _| routes.contains_key(it));
        }
        let (subject, _) = key;
        let Some(skipped) = self.messages.take(&subject, origin, message.sequence) else {
            return;
        };
        if skipped > 0
            && let Some(it) = self.peers.get_mut(&peer)
        {
            // A peer can number its messages as it likes.
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
        self.messages.latched.keep(subject, source, message);
    }
}
