//! The way of messages, calls and changes from the threads of Zenoh to that of the bridge.

use std::borrow::Cow;
use std::collections::{BTreeSet, VecDeque};
use std::io;
use std::mem;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use sm2_bridge_core::Payload;
use sm2_bridge_core::domain::{Service, Topic};
use sm2_io::Waker;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;
use zenoh::sample::{Sample, SampleKind};

/// How many messages may wait, and how long their payloads may be together, in bytes. Messages beyond that are dropped
/// and counted.
const MESSAGES_MAX: usize = 1_024;
const WAITING_MAX_BYTES: u64 = 64 << 20;
/// How many liveliness tokens are followed. Tokens beyond that are ignored.
const TOKENS_MAX: usize = 16_384;

/// A message of the network.
pub(crate) struct Message {
    pub(crate) subject: Subject,
    pub(crate) encoding: Encoding,
    pub(crate) payload: ZBytes,
    pub(crate) attachment: Option<ZBytes>,
}

impl Payload for Message {
    fn payload(&self) -> Cow<'_, [u8]> {
        self.payload.to_bytes()
    }
}

/// The subject of a message.
pub(crate) enum Subject {
    /// The topic of its subscription.
    Topic(Arc<Topic>),
    /// The key expression, for a subscription to many topics.
    Key(String),
}

/// A message, or a call of a service of the domain.
pub(crate) enum Event {
    Message(Message),
    Query(Arc<Service>, Query),
}

impl Event {
    fn payload_len(&self) -> u64 {
        let payload = match self {
            Self::Message(message) => Some(&message.payload),
            Self::Query(_, query) => query.payload(),
        };
        payload.map_or(0, |it| it.len() as u64)
    }
}

/// The way from the threads of Zenoh to that of the bridge.
#[derive(Clone)]
pub(super) struct Inbox {
    events: SyncSender<Event>,
    state: Arc<Mutex<State>>,
    /// Readable while there may be something.
    ready: Arc<Waker>,
}

#[derive(Default)]
struct State {
    /// The length of the payloads that wait, in bytes.
    waiting_bytes: u64,
    /// How many messages were dropped.
    dropped: u64,
    /// The topics whose first subscriber has come, or whose last one has left.
    changed: BTreeSet<Topic>,
    tokens: Tokens,
    /// As many as there are calls, which the bridge limits.
    replies: VecDeque<(u64, Option<ZBytes>)>,
}

/// The end of a call of the domain: its first reply, or none.
pub(super) struct Answer {
    inbox: Inbox,
    number: u64,
    is_given: OnceLock<()>,
}

impl Answer {
    pub(super) fn give(&self, payload: Option<ZBytes>) {
        if self.is_given.set(()).is_ok() {
            self.inbox.lock().replies.push_back((self.number, payload));
            self.inbox.wake();
        }
    }
}

impl Drop for Answer {
    fn drop(&mut self) {
        self.give(None);
    }
}

/// The liveliness tokens that are alive.
#[derive(Default)]
struct Tokens {
    alive: BTreeSet<String>,
    has_changed: bool,
    /// Whether a token was ignored.
    is_over_limit: bool,
}

impl Tokens {
    fn note(&mut self, key: &str, is_alive: bool) {
        self.has_changed |= match is_alive {
            false => self.alive.remove(key),
            true if self.alive.len() < TOKENS_MAX => self.alive.insert(key.to_owned()),
            true => {
                if !self.is_over_limit {
                    tracing::warn!(
                        "the network has more than {TOKENS_MAX} endpoints: the others are ignored"
                    );
                }
                self.is_over_limit = true;
                false
            }
        };
    }
}

impl Inbox {
    pub(super) fn new() -> io::Result<(Self, Receiver<Event>)> {
        let (sender, events) = sync_channel(MESSAGES_MAX);
        let inbox = Self {
            events: sender,
            state: Arc::default(),
            ready: Arc::new(Waker::new()?),
        };
        Ok((inbox, events))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a message.
    pub(super) fn put_sample(&self, subject: Subject, sample: &Sample) {
        if sample.kind() == SampleKind::Put {
            self.put(Event::Message(Message {
                subject,
                encoding: sample.encoding().clone(),
                payload: sample.payload().clone(),
                attachment: sample.attachment().cloned(),
            }));
        }
    }

    /// Notes a message or a call of the network.
    pub(super) fn put(&self, event: Event) {
        let len = event.payload_len();
        let mut state = self.lock();
        let fits = state.waiting_bytes + len <= WAITING_MAX_BYTES;
        match fits && self.events.try_send(event).is_ok() {
            true => state.waiting_bytes += len,
            false => state.dropped += 1,
        }
        drop(state);
        self.wake();
    }

    /// Takes the next message or call of the network.
    pub(super) fn take(&self, events: &Receiver<Event>) -> Option<Event> {
        let event = events.try_recv().ok()?;
        self.lock().waiting_bytes -= event.payload_len();
        Some(event)
    }

    /// Takes the next reply to a call of the domain.
    pub(super) fn take_reply(&self) -> Option<(u64, Option<ZBytes>)> {
        self.lock().replies.pop_front()
    }

    /// Notes that the first subscriber of a topic has come, or the last one has left.
    pub(super) fn note_change(&self, topic: Topic) {
        self.lock().changed.insert(topic);
        self.wake();
    }

    pub(super) fn take_changed(&self) -> BTreeSet<Topic> {
        mem::take(&mut self.lock().changed)
    }

    /// Notes that a token is alive, or is not any more.
    pub(super) fn note_token(&self, key: &str, is_alive: bool) {
        self.lock().tokens.note(key, is_alive);
        self.wake();
    }

    /// The tokens that are alive, if they have changed since the last call.
    pub(super) fn take_tokens(&self) -> Option<BTreeSet<String>> {
        let tokens = &mut self.lock().tokens;
        mem::take(&mut tokens.has_changed).then(|| tokens.alive.clone())
    }

    /// Will note the end of a call of the domain.
    pub(super) fn answer(&self, number: u64) -> Answer {
        Answer {
            inbox: self.clone(),
            number,
            is_given: OnceLock::new(),
        }
    }

    /// How many messages and calls came while too many others waited.
    pub(super) fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    /// Readable while there may be something.
    pub(super) const fn ready(&self) -> &Arc<Waker> {
        &self.ready
    }

    /// Lets the descriptor wait for events that come later than this call.
    pub(super) fn clear_ready(&self) {
        self.ready.drain();
    }

    /// Makes the descriptor readable.
    pub(super) fn wake(&self) {
        self.ready.wake();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(len: usize) -> Event {
        Event::Message(Message {
            subject: Subject::Key(String::new()),
            encoding: Encoding::ZENOH_BYTES,
            payload: ZBytes::from(vec![0; len]),
            attachment: None,
        })
    }

    #[test]
    fn messages_beyond_the_limits_are_dropped_and_counted() {
        let (inbox, messages) = Inbox::new().unwrap();
        let whole = WAITING_MAX_BYTES as usize;
        inbox.put(message(whole));
        inbox.put(message(1));
        assert_eq!(inbox.lock().dropped, 1);
        assert!(inbox.take(&messages).is_some());
        for _ in 0..MESSAGES_MAX {
            inbox.put(message(1));
        }
        assert_eq!(inbox.lock().dropped, 1);
        inbox.put(message(1));
        assert_eq!(inbox.lock().dropped, 2);
        assert_eq!(inbox.lock().waiting_bytes, MESSAGES_MAX as u64);
    }
    #[test]
    fn tokens_beyond_the_limit_are_ignored() {
        let mut tokens = Tokens::default();
        for number in 0..TOKENS_MAX {
            tokens.note(&number.to_string(), true);
        }
        assert!(mem::take(&mut tokens.has_changed));
        tokens.note("another", true);
        assert!(!tokens.has_changed);
        tokens.note("0", false);
        tokens.note("another", true);
        assert!(tokens.has_changed);
        assert!(tokens.alive.contains("another"));
        assert_eq!(tokens.alive.len(), TOKENS_MAX);
    }
}
