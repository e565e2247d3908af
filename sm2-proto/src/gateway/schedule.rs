//! The scheduler of one connection: which message of which topic goes to the peer next.
//!
//! [`Schedule`] is a [`Machine`]. Whenever its driver can write bytes to the network, it follows the
//! [`order`](Schedule::order) of that time: it writes bytes of a message in flight, or feeds
//! [`Input::Start`] for a message that is ready. It feeds [`Input::Sent`] when all bytes of a message
//! have left.
//!
//! Each topic has at most one message in flight and a queue of the newest messages behind it. A
//! message starts when its first byte can be written, so that the next message is chosen as late as
//! possible.
//!
//! Topics share the connection by weighted fair queueing of whole messages. The *start tag* of a
//! message is the virtual time when its topic began to wait. Its *finish tag* is the virtual time when
//! the topic would have sent it, if all topics with messages sent their shares byte by byte. The
//! message with the smallest finish tag goes first. A short message of a quiet topic therefore
//! overtakes a long message in flight, and a topic that has used more than its share waits for the
//! others.
//!
//! # Bound of the wait
//!
//! A topic of weight `w` begins to wait at virtual time `v`, for a message of at most `len` bytes. Until
//! this message is sent, every other topic, of weight `u`, sends at most one message and `len * u / w`
//! bytes (SM2-GWM-005). Proof:
//!
//! 1. The finish tag of the message is at most `v + len / w`, and stays so: neither later publications
//!    nor drops change a start tag. Only the start of a message ends it.
//! 2. As long as the message waits or is in flight, bytes are written only of messages with finish tags
//!    of at most `v + len / w`.
//! 3. The other topic may have one message with a start tag before `v`. Each message after that one gets
//!    its start tag when the previous one was sent. The virtual time was at least `v` then, and at least
//!    the finish tag of the previous message.
//! 4. The finish tags of these messages therefore grow from `v` by `bytes / u` for each of them. They
//!    have at most `len * u / w` bytes together, since none exceeds `v + len / w`.
//!
//! All messages together have a memory budget. Above it, the topic with the most queued bytes loses
//! its oldest queued messages.

mod input;
mod qos;

use alloc::collections::{BTreeMap, BTreeSet, VecDeque};
use core::convert::Infallible;

pub use self::{
    input::{DropCause, Input, Misuse, Next, Output, QueuedMessage},
    qos::{PRIORITY_MAX, SendQos},
};
use super::OfferId;
use crate::{
    Instant, Machine, MisuseError, limits::MESSAGES_IN_FLIGHT_MAX, machine::debug_assert_drained,
};

/// The scheduler of one connection. `M` is the driver's type of messages.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Schedule<M> {
    topics: BTreeMap<OfferId, TopicQueue<M>>,
    /// The topics with a message in flight, by its finish tag.
    in_flight: BTreeSet<(u64, OfferId)>,
    /// The topics whose next message may start, by its finish tag.
    ready: BTreeSet<(u64, OfferId)>,
    /// The topics whose next message expires, or may start, at this time.
    timers: BTreeSet<(Instant, OfferId)>,
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
    /// The virtual time since which the topic waits to start a message. A message that is dropped
    /// keeps its place for the next one.
    start_tag: Option<u64>,
    /// The finish tag of the next message, if the topic is in [`Schedule::ready`].
    ready: Option<u64>,
    /// The time of the topic in [`Schedule::timers`].
    timer: Option<Instant>,
    /// The time when the rate allows the next message.
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
            timers: BTreeSet::new(),
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
            Input::Limit { max_bytes } => {
                self.max_bytes = max_bytes;
                self.displace(now);
            }
            Input::Start { offer } => self.start(now, offer)?,
            Input::Sent { offer } => self.sent(now, offer)?,
            Input::Tick => {}
        }
        while let Some(&(_, offer)) = self.timers.first().filter(|(at, _)| *at <= now) {
            self.refresh(now, offer);
        }
        self.invariants();
        Ok(())
    }

    fn poll(&mut self) -> Option<Output<M>> {
        self.outputs.pop_front()
    }

    /// The time when a rate limit allows the next message, or a message expires.
    fn deadline(&self) -> Option<Instant> {
        self.timers.first().map(|(at, _)| *at)
    }
}

impl<M> Schedule<M> {
    /// The messages that the driver can write now. It writes the first one, and others only if the peer takes no
    /// bytes of those before.
    pub fn order(&self) -> impl Iterator<Item = Next> {
        let may_start = MESSAGES_IN_FLIGHT_MAX.saturating_sub(self.in_flight.len());
        let mut in_flight = self.in_flight.iter().peekable();
        let mut ready = self.ready.iter().take(may_start).peekable();
        core::iter::from_fn(move || match (in_flight.peek(), ready.peek()) {
            (Some(first), Some(next)) if next < first => {
                ready.next().map(|it| Next::Start { offer: it.1 })
            }
            (Some(_), _) => in_flight.next().map(|it| Next::Continue { offer: it.1 }),
            (None, _) => ready.next().map(|it| Next::Start { offer: it.1 }),
        })
    }

    /// The message that [`Input::Start`] would start, unless it expires before.
    #[must_use]
    pub fn next(&self, offer: OfferId) -> Option<&QueuedMessage<M>> {
        let topic = self.topics.get(&offer);
        topic.filter(|it| it.ready.is_some())?.waiting.front()
    }

    /// The memory that the messages may occupy.
    #[must_use]
    pub const fn max_bytes(&self) -> u64 {
        self.max_bytes
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
            start_tag: None,
            ready: None,
            timer: None,
            free_at: Instant(0),
        };
        self.topics.insert(offer, topic);
        Ok(())
    }

    fn change(&mut self, now: Instant, offer: OfferId, qos: SendQos) -> Result<(), Misuse> {
        let topic = self.topic(offer)?;
        topic.qos = qos;
        // Messages sent under the old limits do not count against the new ones.
        topic.free_at = Instant(0);
        self.refresh(now, offer);
        Ok(())
    }

    fn close(&mut self, offer: OfferId) -> Result<(), Misuse> {
        let topic = self.topics.remove(&offer).ok_or(Misuse::NotOpen)?;
        if let Some(at) = topic.timer {
            self.timers.remove(&(at, offer));
        }
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
        if let Some(at) = topic.timer.take() {
            self.timers.remove(&(at, offer));
        }
        let Some(next) = topic.waiting.front() else {
            return;
        };
        let mut timer = topic.qos.expires_at(next.published_at);
        if topic.in_flight.is_none() && topic.free_at > now {
            timer = timer.into_iter().chain([topic.free_at]).min();
        } else if topic.in_flight.is_none() {
            //= SM2-GWM-005
            let start_tag = *topic.start_tag.get_or_insert(self.finish_tag);
            let finish_tag = start_tag.saturating_add(topic.qos.virtual_len(next.len_bytes));
            topic.ready = Some(finish_tag);
            self.ready.insert((finish_tag, offer));
        }
        topic.timer = timer;
        self.timers.extend(timer.map(|at| (at, offer)));
    }

    /// Starts the next message of a topic. Messages that are too old by now are dropped instead.
    //= SM2-GWM-006
    fn start(&mut self, now: Instant, offer: OfferId) -> Result<(), Misuse> {
        let is_full = self.in_flight.len() >= MESSAGES_IN_FLIGHT_MAX;
        if self.topic(offer)?.ready.is_none() || is_full {
            return Err(Misuse::NotReady);
        }
        self.refresh(now, offer);
        let topic = self.topic(offer)?;
        let Some(finish_tag) = topic.ready.take() else {
            return Ok(());
        };
        if let Some(next) = topic.pop() {
            let len_bytes = next.len_bytes;
            topic.start_tag = None;
            topic.in_flight = Some(InFlight {
                finish_tag,
                len_bytes,
            });
            topic.free_at = now.after(topic.qos.interval(len_bytes));
            let message = next.message;
            self.outputs.push_back(Output::Start { offer, message });
            self.in_flight.insert((finish_tag, offer));
        }
        self.ready.remove(&(finish_tag, offer));
        self.refresh(now, offer);
        Ok(())
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
        let is_ready = |(finish_tag, offer): &(u64, OfferId)| {
            let topic = self.topics.get(offer);
            topic.is_some_and(|it| it.ready == Some(*finish_tag) && it.in_flight.is_none())
        };
        debug_assert!(self.ready.iter().all(is_ready));
        let timers = self.topics.values().filter(|it| it.timer.is_some());
        debug_assert_eq!(timers.count(), self.timers.len());
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
        } else if self.qos.is_expired(oldest.published_at, now) {
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
