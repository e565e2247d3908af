//! The messages of latched topics, for peers that subscribe later.
//!
//! Latched messages are kept at each hop. Each gateway on the path keeps the newest messages of a latched topic while
//! it subscribes to the topic itself, for peers that subscribe later. The proxy of the publisher in the other domain is
//! latched as well.

use std::collections::{BTreeMap, VecDeque};

use sm2_proto::gateway::{Subject, router::Source};

use crate::message::Message;

/// The greatest number of messages that are kept of a topic, however many its publishers keep.
pub const LATCHED_MAX: u16 = 64;
/// The limit of the payloads of all topics.
const BYTES_MAX: usize = 64 << 20;

/// The newest messages of each latched topic that the gateway takes itself.
#[derive(Debug, Default)]
pub(super) struct Latched {
    /// By topic and source, the newest last.
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

    /// The gateway no longer takes the topic, so it would miss newer messages.
    pub(super) fn forget(&mut self, subject: &Subject, source: Source) {
        let kept = self.kept.remove(&(subject.clone(), source));
        let bytes = kept.iter().flatten().map(|it| it.payload.len());
        self.bytes -= bytes.sum::<usize>();
    }

    /// The messages of a topic, the oldest first.
    pub(super) fn messages(&self, subject: &Subject, source: Source) -> Vec<Message> {
        let kept = self.kept.get(&(subject.clone(), source));
        kept.into_iter().flatten().cloned().collect()
    }
}
