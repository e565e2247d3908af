//! The scheduler of one connection: which message of which topic goes to the peer next.
//!
//! [`Schedule`] is a [`Machine`]. Its driver writes the bytes of the messages in flight to the
//! network, in the [`order`](Schedule::order) that they have at that time, and feeds
//! [`Input::Sent`] when all bytes of a message have left.
//!
//! Each topic has at most one message in flight and a queue of the newest messages behind it, so
//! that the next message is chosen as late as possible.
//!
//! Topics share the connection by weighted fair queueing of whole messages. The *finish tag* of a
//! message is the virtual time at which its topic would have sent it, if all topics with messages
//! sent their shares byte by byte. The message with the smallest finish tag goes first. A short
//! message of a quiet topic therefore overtakes a long message in flight, and a topic that has
//! used more than its share waits for the others.
//!
//! All messages together have a memory budget. Above it, the topic with the most queued bytes loses
//! its oldest queued messages.

use alloc::collections::{BTreeMap, BTreeSet, VecDeque};
use core::{
    convert::Infallible,
    num::{NonZeroU32, NonZeroU64},
    time::Duration,
};

use super::OfferId;
use crate::{
    Instant, Machine, MisuseError, limits::MESSAGES_IN_FLIGHT_MAX, machine::debug_assert_drained,
};

/// The greatest [`SendQos::priority`].
pub const PRIORITY_MAX: u8 = 7;

const NANOS_PER_S: u64 = 1_000_000_000;

/// How the messages of one topic are sent to a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SendQos {
    /// How many messages are queued at most, besides the one in flight; 0 counts as 1.
    pub depth: u16,
    /// The weight of the topic: each step, up to [`PRIORITY_MAX`], doubles its share.
    pub priority: u8,
    /// The greatest rate of messages.
    pub messages_per_s: Option<NonZeroU32>,
    /// The greatest rate of bytes, averaged over messages.
    pub bytes_per_s: Option<NonZeroU64>,
    /// The greatest age, since publication, of a message that starts.
    pub max_age: Option<Duration>,
}

/// A message in the queue of its topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QueuedMessage<M> {
    /// The driver's message. The scheduler only hands it back.
    pub message: M,
    /// Its length on the network, with its header.
    pub len_bytes: u64,
    /// The time of its publication.
    pub published: Instant,
}

/// An input of a [`Schedule`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input<M> {
    /// The peer wants a topic.
    Open {
        /// The offer of the topic.
        offer: OfferId,
        /// How its messages are sent.
        qos: SendQos,
    },
    /// The QoS of a topic has changed.
    Change {
        /// The offer of the topic.
        offer: OfferId,
        /// How its messages are sent from now on.
        qos: SendQos,
    },
    /// The peer no longer wants a topic, or may no longer have it.
    Close {
        /// The offer of the topic.
        offer: OfferId,
    },
    /// A message was published.
    Enqueue {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: QueuedMessage<M>,
    },
    /// Every byte of the message in flight has left at least once, or the peer has refused it.
    Sent {
        /// The offer of its topic.
        offer: OfferId,
    },
    /// Time has passed.
    Tick,
}

/// An output of a [`Schedule`].
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output<M> {
    /// The message is in flight: send it in the [order](Schedule::order).
    Start {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: M,
    },
    /// The message, which was not started, is not sent.
    Drop {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: M,
        /// The reason.
        cause: DropCause,
    },
    /// Abandon the message in flight: reset its stream.
    Reset {
        /// The offer of its topic.
        offer: OfferId,
    },
}

/// Why a message was dropped before it was started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DropCause {
    /// Newer messages took its place in the queue.
    Superseded,
    /// Newer messages, perhaps of other topics, took its place in the memory budget.
    Displaced,
    /// It exceeded [`SendQos::max_age`].
    Expired,
    /// Its topic was closed.
    Withdrawn,
}

/// An input that is not legal now; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misuse {
    /// The topic of this offer is open already.
    #[error("the topic of this offer is open already")]
    Open,
    /// The topic of this offer is not open.
    #[error("the topic of this offer is not open")]
    NotOpen,
    /// The topic of this offer has no message in flight.
    #[error("the topic of this offer has no message in flight")]
    NotSending,
}

/// The scheduler of one connection. `M` is the driver's type of messages.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Schedule<M> {
    topics: BTreeMap<OfferId, TopicQueue<M>>,
    /// The topics with a message in flight, by its finish tag.
    in_flight: BTreeSet<(u64, OfferId)>,
    /// The topics whose next message waits until fewer messages are in flight, by its finish tag.
    ready: BTreeSet<(u64, OfferId)>,
    /// The topics that have used up their rate, by the time at which they may send again.
    rate_limited: BTreeSet<(Instant, OfferId)>,
    /// The virtual time: the greatest finish tag of a message that was sent.
    finish_tag: u64,
    /// The limit of `held_bytes`.
    max_bytes: u64,
    /// The sum of the lengths of all messages, queued or in flight.
    held_bytes: u128,
    outputs: VecDeque<Output<M>>,
}

/// The messages of one topic.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct TopicQueue<M> {
    qos: SendQos,
    /// The oldest first.
    waiting: VecDeque<QueuedMessage<M>>,
    /// The sum of the lengths of the waiting messages.
    waiting_bytes: u128,
    /// The message in flight.
    in_flight: Option<InFlight>,
    /// The finish tag of the next message, if the topic is in [`Schedule::ready`].
    ready: Option<u64>,
    /// The time at which the rate allows the next message.
    free_at: Instant,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct InFlight {
    finish_tag: u64,
    len_bytes: u64,
}

impl<M> Schedule<M> {
    /// A scheduler without topics. Its messages occupy at most `max_bytes`, except that a message
    /// in flight always stays.
    #[must_use]
    pub fn new(max_bytes: u64) -> Self {
        Self {
            max_bytes,
            held_bytes: 0,
            topics: BTreeMap::new(),
            in_flight: BTreeSet::new(),
            ready: BTreeSet::new(),
            rate_limited: BTreeSet::new(),
            finish_tag: 0,
            outputs: VecDeque::new(),
        }
    }
}

impl<M> Default for Schedule<M> {
    /// A scheduler without topics and without a limit of memory.
    fn default() -> Self {
        Self::new(u64::MAX)
    }
}

impl<M> Machine for Schedule<M> {
    type Input<'a> = Input<M>;
    type Output = Output<M>;
    /// A schedule never ends.
    type End = Infallible;
    type Misuse = Misuse;

    fn handle(&mut self, now: Instant, input: Input<M>) -> Result<(), MisuseError<Misuse>> {
        debug_assert_drained(&self.outputs);
        match input {
            Input::Open { offer, qos } => self.open(offer, qos)?,
            Input::Change { offer, qos } => self.change(now, offer, qos)?,
            Input::Close { offer } => self.close(offer)?,
            Input::Enqueue { offer, message } => {
                self.enqueue(now, offer, message)?;
                self.displace(now);
            }
            Input::Sent { offer } => self.sent(now, offer)?,
            Input::Tick => {}
        }
        while let Some(&(at, offer)) = self.rate_limited.first().filter(|(at, _)| *at <= now) {
            self.rate_limited.remove(&(at, offer));
            self.refresh(now, offer);
        }
        self.fill(now);
        self.invariants();
        Ok(())
    }

    fn poll(&mut self) -> Option<Output<M>> {
        self.outputs.pop_front()
    }

    /// The time at which a rate limit allows the next message.
    fn deadline(&self) -> Option<Instant> {
        self.rate_limited.first().map(|(at, _)| *at)
    }
}

impl<M> Schedule<M> {
    /// The offers that have a message in flight, in the order in which their bytes are sent now.
    pub fn order(&self) -> impl Iterator<Item = OfferId> {
        self.in_flight.iter().map(|(_, offer)| *offer)
    }

    /// True if the topic of this offer is open.
    #[must_use]
    pub fn is_open(&self, offer: OfferId) -> bool {
        self.topics.contains_key(&offer)
    }

    fn topic(&mut self, offer: OfferId) -> Result<&mut TopicQueue<M>, Misuse> {
        self.topics.get_mut(&offer).ok_or(Misuse::NotOpen)
    }

    fn open(&mut self, offer: OfferId, qos: SendQos) -> Result<(), Misuse> {
        if self.is_open(offer) {
            return Err(Misuse::Open);
        }
        let topic = TopicQueue {
            qos,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            in_flight: None,
            ready: None,
            free_at: Instant(0),
        };
        self.topics.insert(offer, topic);
        Ok(())
    }

    fn change(&mut self, now: Instant, offer: OfferId, qos: SendQos) -> Result<(), Misuse> {
        let topic = self.topic(offer)?;
        topic.qos = qos;
        // Messages sent under the old limits do not count against the new ones.
        let free_at = core::mem::replace(&mut topic.free_at, Instant(0));
        self.rate_limited.remove(&(free_at, offer));
        self.refresh(now, offer);
        Ok(())
    }

    fn close(&mut self, offer: OfferId) -> Result<(), Misuse> {
        let topic = self.topics.remove(&offer).ok_or(Misuse::NotOpen)?;
        self.rate_limited.remove(&(topic.free_at, offer));
        if let Some(finish_tag) = topic.ready {
            self.ready.remove(&(finish_tag, offer));
        }
        self.held_bytes -= topic.waiting_bytes;
        if let Some(it) = topic.in_flight {
            self.held_bytes -= u128::from(it.len_bytes);
            self.in_flight.remove(&(it.finish_tag, offer));
            self.outputs.push_back(Output::Reset { offer });
        }
        let dropped = topic.waiting.into_iter().map(|it| Output::Drop {
            offer,
            message: it.message,
            cause: DropCause::Withdrawn,
        });
        self.outputs.extend(dropped);
        Ok(())
    }

    fn enqueue(
        &mut self,
        now: Instant,
        offer: OfferId,
        message: QueuedMessage<M>,
    ) -> Result<(), Misuse> {
        let topic = self.topic(offer)?;
        topic.waiting_bytes += u128::from(message.len_bytes);
        self.held_bytes += u128::from(message.len_bytes);
        self.topic(offer)?.waiting.push_back(message);
        self.refresh(now, offer);
        Ok(())
    }

    /// Drops queued messages until the memory budget suffices.
    fn displace(&mut self, now: Instant) {
        while self.held_bytes > u128::from(self.max_bytes) {
            let waiting = self.topics.iter().filter(|(_, it)| !it.waiting.is_empty());
            let Some((&offer, _)) = waiting.max_by_key(|(_, it)| it.waiting_bytes) else {
                return;
            };
            self.drop_oldest(offer, DropCause::Displaced);
            self.refresh(now, offer);
        }
    }

    fn drop_oldest(&mut self, offer: OfferId, cause: DropCause) {
        let topic = self.topics.get_mut(&offer);
        let Some(oldest) = topic.and_then(TopicQueue::pop) else {
            return;
        };
        self.held_bytes -= u128::from(oldest.len_bytes);
        let message = oldest.message;
        self.outputs.push_back(Output::Drop {
            offer,
            message,
            cause,
        });
    }

    fn sent(&mut self, now: Instant, offer: OfferId) -> Result<(), Misuse> {
        let in_flight = self.topic(offer)?.in_flight.take();
        let InFlight {
            finish_tag,
            len_bytes,
        } = in_flight.ok_or(Misuse::NotSending)?;
        self.held_bytes -= u128::from(len_bytes);
        self.in_flight.remove(&(finish_tag, offer));
        // A topic that was idle starts from here, so it has no unused share to catch up with.
        self.finish_tag = self.finish_tag.max(finish_tag);
        self.refresh(now, offer);
        Ok(())
    }

    /// Drops messages that are no longer needed, and determines what the next one waits for.
    fn refresh(&mut self, now: Instant, offer: OfferId) {
        while let Some(cause) = self.topics.get(&offer).and_then(|it| it.shed(now)) {
            self.drop_oldest(offer, cause);
        }
        let Some(topic) = self.topics.get_mut(&offer) else {
            return;
        };
        if let Some(finish_tag) = topic.ready.take() {
            self.ready.remove(&(finish_tag, offer));
        }
        let Some(next) = topic.waiting.front().filter(|_| topic.in_flight.is_none()) else {
            return;
        };
        if topic.free_at > now {
            self.rate_limited.insert((topic.free_at, offer));
            return;
        }
        let finish_tag = (self.finish_tag).saturating_add(topic.qos.virtual_len(next.len_bytes));
        topic.ready = Some(finish_tag);
        self.ready.insert((finish_tag, offer));
    }

    /// Starts ready messages while the limit of messages in flight allows.
    fn fill(&mut self, now: Instant) {
        while self.in_flight.len() < MESSAGES_IN_FLIGHT_MAX
            && let Some((finish_tag, offer)) = self.ready.pop_first()
        {
            let Some(topic) = self.topics.get_mut(&offer) else {
                continue;
            };
            topic.ready = None;
            let Some(next) = topic.pop() else {
                continue;
            };
            topic.in_flight = Some(InFlight {
                finish_tag,
                len_bytes: next.len_bytes,
            });
            topic.free_at = now.after(topic.qos.interval(next.len_bytes));
            self.in_flight.insert((finish_tag, offer));
            let message = next.message;
            self.outputs.push_back(Output::Start { offer, message });
        }
    }

    /// Checks what holds between any two calls.
    fn invariants(&self) {
        let is_in_flight = |(finish_tag, offer): &(u64, OfferId)| {
            let topic = self.topics.get(offer);
            topic
                .and_then(|it| it.in_flight)
                .is_some_and(|it| it.finish_tag == *finish_tag)
        };
        debug_assert!(self.in_flight.iter().all(is_in_flight));
        let in_flight = self.topics.values().filter(|it| it.in_flight.is_some());
        debug_assert_eq!(in_flight.count(), self.in_flight.len());
        debug_assert!(self.in_flight.len() <= MESSAGES_IN_FLIGHT_MAX);
        let is_full = self.in_flight.len() == MESSAGES_IN_FLIGHT_MAX;
        debug_assert!(self.ready.is_empty() || is_full);
        let is_bounded = |it: &TopicQueue<M>| it.waiting.len() <= it.qos.depth();
        debug_assert!(self.topics.values().all(is_bounded));
        let has_sum = |it: &TopicQueue<M>| {
            let lens = it.waiting.iter().map(|it| u128::from(it.len_bytes));
            it.waiting_bytes == lens.sum::<u128>()
        };
        debug_assert!(self.topics.values().all(has_sum));
    }
}

impl<M> TopicQueue<M> {
    /// Why the oldest message is dropped now: there are too many, or it is too old.
    //= SM2-GWM-004
    fn shed(&self, now: Instant) -> Option<DropCause> {
        let oldest = self.waiting.front()?;
        if self.waiting.len() > self.qos.depth() {
            Some(DropCause::Superseded)
        } else if self.qos.is_expired(oldest.published, now) {
            Some(DropCause::Expired)
        } else {
            None
        }
    }

    fn pop(&mut self) -> Option<QueuedMessage<M>> {
        let oldest = self.waiting.pop_front()?;
        self.waiting_bytes -= u128::from(oldest.len_bytes);
        Some(oldest)
    }
}

impl SendQos {
    fn depth(&self) -> usize {
        usize::from(self.depth.max(1))
    }

    /// By how much a message advances the virtual time of its topic: its length divided by the
    /// weight of the topic, in units of the greatest weight.
    fn virtual_len(&self, len_bytes: u64) -> u64 {
        let steps_below_max = PRIORITY_MAX - self.priority.min(PRIORITY_MAX);
        len_bytes.max(1).saturating_mul(1 << steps_below_max)
    }

    /// How long the rate limits make a topic wait after a message.
    fn interval(&self, len_bytes: u64) -> Duration {
        let by_messages = self
            .messages_per_s
            .map_or(0, |it| NANOS_PER_S / u64::from(it.get()));
        let by_bytes = self.bytes_per_s.map_or(0, |it| {
            let nanos = u128::from(len_bytes) * u128::from(NANOS_PER_S) / u128::from(it.get());
            u64::try_from(nanos).unwrap_or(u64::MAX)
        });
        Duration::from_nanos(by_messages.max(by_bytes))
    }

    fn is_expired(&self, published: Instant, now: Instant) -> bool {
        (self.max_age).is_some_and(|it| now.since(published) > it)
    }
}
