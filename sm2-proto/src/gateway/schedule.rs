//! What goes to one peer next: the newest messages of each topic, and fair shares of the way.
//!
//! Feed what happened with [`handle`](Schedule::handle), then do what [`poll`](Schedule::poll)
//! says until it says nothing, and give the bytes of the messages in flight to the network in
//! the [`order`](Schedule::order) that they have then. Call again at the
//! [`deadline`](Schedule::deadline).
//!
//! Each topic has at most one message in flight, so that the next one is chosen as late as can
//! be. Which of them goes first is weighted fair queueing: a message's *finish tag* is where its
//! topic would be if all topics that have something to send got their shares byte by byte. A short
//! message of a topic that seldom has one overtakes a long one that is under way; a topic
//! that has more than its share waits for the others.

use alloc::collections::{BTreeMap, BTreeSet, VecDeque};
use core::{
    num::{NonZeroU32, NonZeroU64},
    time::Duration,
};

use super::OfferId;
use crate::{Instant, limits::MESSAGES_IN_FLIGHT_MAX};

/// The greatest [`Terms::priority`].
pub const PRIORITY_MAX: u8 = 7;

const NANOS_PER_S: u64 = 1_000_000_000;

/// How messages of one topic go to the peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Terms {
    /// How many messages wait at most, besides the one in flight; 0 counts as 1.
    pub depth: u16,
    /// Each step, up to [`PRIORITY_MAX`], doubles the share of the way.
    pub priority: u8,
    /// How many messages go at most.
    pub messages_per_s: Option<NonZeroU32>,
    /// How many bytes go at most, in the long run.
    pub bytes_per_s: Option<NonZeroU64>,
    /// Since publication: older messages do not set out.
    pub max_age: Option<Duration>,
}

/// A message that could be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Message {
    /// The driver's name for it.
    pub key: u64,
    /// With its header.
    pub len_bytes: u64,
    /// When it was published.
    pub published: Instant,
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// The peer wants a topic.
    Open {
        /// The number of its offer.
        offer: OfferId,
        /// How its messages go.
        terms: Terms,
    },
    /// There are other rules for a topic.
    Change {
        /// The number of its offer.
        offer: OfferId,
        /// How its messages go from now on.
        terms: Terms,
    },
    /// The peer does not want it any more, or may not have it.
    Close {
        /// The number of the offer.
        offer: OfferId,
    },
    /// A message was published.
    Message {
        /// The number of the offer.
        offer: OfferId,
        /// The message.
        message: Message,
    },
    /// Every byte of the message in flight has left at least once.
    Sent {
        /// The number of the offer.
        offer: OfferId,
    },
    /// Time has passed.
    Tick,
}

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Open a stream for this message.
    Start {
        /// The number of the offer.
        offer: OfferId,
        /// Which.
        key: u64,
    },
    /// This message, which was not started, is not needed any more.
    Drop {
        /// Which.
        key: u64,
        /// Why.
        cause: Cause,
    },
    /// Reset the stream of this message.
    Reset {
        /// Which.
        key: u64,
    },
}

/// Why a message was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// Newer ones took its place.
    Superseded,
    /// It was too old before its turn came.
    Expired,
    /// Its topic was closed.
    Withdrawn,
}

/// What the driver may not do; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misuse {
    /// This offer is open already.
    #[error("the offer is open already")]
    Open,
    /// This offer is not open.
    #[error("the offer is not open")]
    NotOpen,
    /// This offer has no message in flight.
    #[error("no message of the offer is in flight")]
    NotSending,
}

/// The messages for one peer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Schedule {
    topics: BTreeMap<OfferId, Topic>,
    /// The messages in flight, by finish tag and offer.
    in_flight: BTreeSet<(u64, OfferId)>,
    /// The topics that wait for others to be done, likewise.
    ready: BTreeSet<(u64, OfferId)>,
    /// The topics whose budget is spent until then.
    spent: BTreeSet<(Instant, OfferId)>,
    /// How far the topics are: the greatest finish tag of a message that was sent.
    finish_tag: u64,
    outputs: VecDeque<Output>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Topic {
    terms: Terms,
    /// The oldest first.
    waiting: VecDeque<Message>,
    /// The finish tag and the key.
    in_flight: Option<(u64, u64)>,
    /// Its finish tag among those that are ready.
    ready: Option<u64>,
    /// When its budget has something left.
    free_at: Instant,
}

impl Terms {
    fn depth(&self) -> usize {
        usize::from(self.depth.max(1))
    }

    /// How far a message takes its topic: the less, the greater its share.
    fn virtual_len(&self, len_bytes: u64) -> u64 {
        let less = PRIORITY_MAX - self.priority.min(PRIORITY_MAX);
        len_bytes.max(1).saturating_mul(1 << less)
    }

    /// How long the budget is spent after a message.
    fn pause(&self, len_bytes: u64) -> Duration {
        let by_number = self
            .messages_per_s
            .map_or(0, |it| NANOS_PER_S / u64::from(it.get()));
        let by_bytes = self.bytes_per_s.map_or(0, |it| {
            let nanos = u128::from(len_bytes) * u128::from(NANOS_PER_S) / u128::from(it.get());
            u64::try_from(nanos).unwrap_or(u64::MAX)
        });
        Duration::from_nanos(by_number.max(by_bytes))
    }

    fn is_too_old(&self, message: &Message, now: Instant) -> bool {
        (self.max_age).is_some_and(|most| now.since(message.published) > most)
    }
}

impl Schedule {
    /// Takes one input.
    ///
    /// # Errors
    /// The offer is not in the state that the input needs: nothing has changed.
    pub fn handle(&mut self, now: Instant, input: Input) -> Result<(), Misuse> {
        match input {
            Input::Open { offer, terms } => self.open(offer, terms)?,
            Input::Change { offer, terms } => self.change(now, offer, terms)?,
            Input::Close { offer } => self.close(offer)?,
            Input::Message { offer, message } => self.message(now, offer, message)?,
            Input::Sent { offer } => self.sent(now, offer)?,
            Input::Tick => {}
        }
        while let Some(&(at, offer)) = self.spent.first().filter(|(at, _)| *at <= now) {
            self.spent.remove(&(at, offer));
            self.look_at(now, offer);
        }
        self.fill(now);
        self.invariants();
        Ok(())
    }

    /// The next thing to do.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When a budget has something left again.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.spent.first().map(|(at, _)| *at)
    }

    /// The offers that have a message in flight: whose bytes go first, first.
    pub fn order(&self) -> impl Iterator<Item = OfferId> {
        self.in_flight.iter().map(|(_, offer)| *offer)
    }

    fn topic(&mut self, offer: OfferId) -> Result<&mut Topic, Misuse> {
        self.topics.get_mut(&offer).ok_or(Misuse::NotOpen)
    }

    fn open(&mut self, offer: OfferId, terms: Terms) -> Result<(), Misuse> {
        if self.topics.contains_key(&offer) {
            return Err(Misuse::Open);
        }
        let topic = Topic {
            terms,
            waiting: VecDeque::new(),
            in_flight: None,
            ready: None,
            free_at: Instant(0),
        };
        self.topics.insert(offer, topic);
        Ok(())
    }

    fn change(&mut self, now: Instant, offer: OfferId, terms: Terms) -> Result<(), Misuse> {
        let topic = self.topic(offer)?;
        topic.terms = terms;
        // What was spent by other rules does not bind these.
        let spent = core::mem::replace(&mut topic.free_at, Instant(0));
        self.spent.remove(&(spent, offer));
        self.look_at(now, offer);
        Ok(())
    }

    fn close(&mut self, offer: OfferId) -> Result<(), Misuse> {
        let topic = self.topics.remove(&offer).ok_or(Misuse::NotOpen)?;
        self.spent.remove(&(topic.free_at, offer));
        if let Some(finish_tag) = topic.ready {
            self.ready.remove(&(finish_tag, offer));
        }
        if let Some((finish_tag, key)) = topic.in_flight {
            self.in_flight.remove(&(finish_tag, offer));
            self.outputs.push_back(Output::Reset { key });
        }
        let cause = Cause::Withdrawn;
        let dropped = topic
            .waiting
            .iter()
            .map(|it| Output::Drop { key: it.key, cause });
        self.outputs.extend(dropped);
        Ok(())
    }

    fn message(&mut self, now: Instant, offer: OfferId, message: Message) -> Result<(), Misuse> {
        self.topic(offer)?.waiting.push_back(message);
        self.look_at(now, offer);
        Ok(())
    }

    fn sent(&mut self, now: Instant, offer: OfferId) -> Result<(), Misuse> {
        let (finish_tag, _) = self
            .topic(offer)?
            .in_flight
            .take()
            .ok_or(Misuse::NotSending)?;
        self.in_flight.remove(&(finish_tag, offer));
        // Whoever comes back after a while has nothing saved up.
        self.finish_tag = self.finish_tag.max(finish_tag);
        self.look_at(now, offer);
        Ok(())
    }

    /// Drops what is not needed, and says what the topic waits for.
    fn look_at(&mut self, now: Instant, offer: OfferId) {
        let Some(topic) = self.topics.get_mut(&offer) else {
            return;
        };
        topic.shed(now, &mut self.outputs);
        if let Some(finish_tag) = topic.ready.take() {
            self.ready.remove(&(finish_tag, offer));
        }
        let Some(next) = topic.waiting.front().filter(|_| topic.in_flight.is_none()) else {
            return;
        };
        if topic.free_at > now {
            self.spent.insert((topic.free_at, offer));
            return;
        }
        let finish_tag = (self.finish_tag).saturating_add(topic.terms.virtual_len(next.len_bytes));
        topic.ready = Some(finish_tag);
        self.ready.insert((finish_tag, offer));
    }

    /// Starts what is ready.
    fn fill(&mut self, now: Instant) {
        while self.in_flight.len() < MESSAGES_IN_FLIGHT_MAX
            && let Some((finish_tag, offer)) = self.ready.pop_first()
        {
            let Some(topic) = self.topics.get_mut(&offer) else {
                continue;
            };
            topic.ready = None;
            let Some(message) = topic.waiting.pop_front() else {
                continue;
            };
            topic.in_flight = Some((finish_tag, message.key));
            topic.free_at = now.after(topic.terms.pause(message.len_bytes));
            self.in_flight.insert((finish_tag, offer));
            self.outputs.push_back(Output::Start {
                offer,
                key: message.key,
            });
        }
    }

    /// What must hold between any two calls.
    fn invariants(&self) {
        let is_in_flight = |(finish_tag, offer): &(u64, OfferId)| {
            let topic = self.topics.get(offer);
            topic
                .and_then(|it| it.in_flight)
                .is_some_and(|it| it.0 == *finish_tag)
        };
        debug_assert!(self.in_flight.iter().all(is_in_flight));
        let in_flight = self.topics.values().filter(|it| it.in_flight.is_some());
        debug_assert_eq!(in_flight.count(), self.in_flight.len());
        debug_assert!(self.in_flight.len() <= MESSAGES_IN_FLIGHT_MAX);
        let is_full = self.in_flight.len() == MESSAGES_IN_FLIGHT_MAX;
        debug_assert!(self.ready.is_empty() || is_full);
        let is_bounded = |it: &Topic| it.waiting.len() <= it.terms.depth();
        debug_assert!(self.topics.values().all(is_bounded));
    }
}

impl Topic {
    //= SM2-GWM-004
    fn shed(&mut self, now: Instant, outputs: &mut VecDeque<Output>) {
        while let Some(oldest) = self.waiting.front() {
            let cause = if self.waiting.len() > self.terms.depth() {
                Cause::Superseded
            } else if self.terms.is_too_old(oldest, now) {
                Cause::Expired
            } else {
                return;
            };
            outputs.push_back(Output::Drop {
                key: oldest.key,
                cause,
            });
            self.waiting.pop_front();
        }
    }
}
