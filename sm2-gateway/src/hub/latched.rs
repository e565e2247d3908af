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

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use sm2_proto::{Instant, Name, TypeId};

    use super::*;

    fn topic(name: &str) -> Subject {
        let name = Name::new(name).unwrap();
        Subject::Topic {
            name: name.clone(),
            data: TypeId { name, hash: 0 },
            reliable: false,
            latched: 2,
        }
    }

    fn message(len: usize) -> Message {
        Message {
            sequence: 1,
            published_at: Instant(0),
            payload: Bytes::from(vec![0; len]),
        }
    }

    #[test]
    fn all_topics_share_the_memory_and_what_is_forgotten_leaves_it() {
        let mut latched = Latched::default();
        let (large, small) = (topic("map"), topic("pose"));
        for _ in 0..3 {
            for _ in 0..3 {
                latched.keep(&large, Source::Local, message(BYTES_MAX / 2));
            }
            assert_eq!(latched.messages(&large, Source::Local).len(), 2);
            latched.keep(&small, Source::Local, message(1));
            assert!(latched.messages(&small, Source::Local).is_empty());
            latched.forget(&large, Source::Local);
            latched.keep(&small, Source::Local, message(1));
            assert_eq!(latched.messages(&small, Source::Local).len(), 1);
            latched.forget(&small, Source::Local);
            assert_eq!(latched.bytes, 0);
        }
    }
}
