//! What latched topics keep for peers that want them later than others.

use std::collections::{BTreeMap, VecDeque};

use sm2_proto::gateway::{GatewayId, OfferId, Subject, router::Source};

use super::Hub;
use crate::{message::Message, peer::Command};

/// So many messages of a topic are kept at most, whatever its publishers keep.
pub const LATCHED_MAX: u16 = 64;
/// Of all topics together.
const BYTES_MAX: usize = 64 << 20;

/// The newest messages of each latched topic that is taken, the newest last.
#[derive(Debug, Default)]
pub(super) struct Latched {
    kept: BTreeMap<(Subject, Source), VecDeque<Message>>,
    bytes: usize,
}

impl Latched {
    pub(super) fn keep(&mut self, subject: &Subject, source: Source, message: Message) {
        let most = usize::from(subject.latched().min(LATCHED_MAX));
        if most == 0 {
            return;
        }
        let kept = self.kept.entry((subject.clone(), source)).or_default();
        self.bytes += message.payload.len();
        kept.push_back(message);
        while kept.len() > most || self.bytes > BYTES_MAX {
            let Some(oldest) = kept.pop_front() else {
                return;
            };
            self.bytes -= oldest.payload.len();
        }
    }

    /// It is not taken any more: newer ones may be missed.
    pub(super) fn forget(&mut self, subject: &Subject, source: Source) {
        let kept = self.kept.remove(&(subject.clone(), source));
        let bytes = kept.iter().flatten().map(|it| it.payload.len());
        self.bytes -= bytes.sum::<usize>();
    }

    fn of(&self, subject: &Subject, source: Source) -> impl Iterator<Item = &Message> {
        self.kept
            .get(&(subject.clone(), source))
            .into_iter()
            .flatten()
    }
}

impl Hub {
    /// A peer wants what others may have wanted before.
    //= SM2-GWM-008
    pub(super) fn replay(&mut self, peer: GatewayId, offer: OfferId) {
        let Some((subject, source)) = self.source(peer, offer) else {
            return;
        };
        let kept = self.messages.latched.of(&subject, source);
        for message in kept.cloned().collect::<Vec<_>>() {
            self.tell(peer, Command::Message { offer, message });
        }
    }
}
