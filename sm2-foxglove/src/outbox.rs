//! The messages that wait for one viewer: at most a budget of bytes, and of each topic the newest ones.
//!
//! Pure: it does no I/O. [`Outbox::control`] and [`Outbox::push`] put frames in, [`Outbox::pop`] takes the next one to
//! write, and [`Outbox::written`] says that this one has left.
//!
//! | rule | purpose |
//! | --- | --- |
//! | control frames go first | a reply or a new channel does not wait for messages |
//! | virtual finish times decide between topics (fair queueing) | a rare topic does not wait behind a large one |
//! | a topic keeps [`TOPIC_BYTES`], or one message | a viewer behind a slow link sees the newest image |
//! | the largest topic loses its oldest messages at the budget | a viewer that stops reading costs no more |

use std::collections::{BTreeMap, VecDeque};

/// The bytes of the messages that wait in one topic, unless a single message is longer.
pub(crate) const TOPIC_BYTES: usize = 256 * 1024;

/// The bytes of the control frames that wait. A viewer that leaves more unread is disconnected.
pub(crate) const CONTROL_BYTES: usize = 16 * 1024 * 1024;

/// The bytes that a frame costs besides its own.
const OVERHEAD_BYTES: usize = 64;

/// A frame of the WebSocket protocol.
pub(crate) type Frame = Vec<u8>;

/// The number of a viewer's subscription.
pub(crate) type SubscriptionId = u32;

/// The messages that wait for one viewer.
#[derive(Debug)]
pub(crate) struct Outbox {
    budget_bytes: usize,
    control: VecDeque<Frame>,
    control_bytes: usize,
    topics: BTreeMap<SubscriptionId, Topic>,
    /// The bytes of all messages that wait.
    waiting_bytes: usize,
    /// The bytes of the message that is being written.
    in_flight_bytes: usize,
    /// The finish time of the message that was taken last.
    virtual_time: u64,
    /// The messages that newer ones have displaced.
    displaced: u64,
}

/// The messages of one topic.
#[derive(Debug)]
struct Topic {
    messages: VecDeque<Frame>,
    bytes: usize,
    /// The virtual time when the first message would begin. A message that displaces the first one begins at its
    /// time: otherwise a topic whose messages are displaced all the time would never be served.
    start_tag: u64,
    /// Whether the topic has had no message since its last one was taken.
    is_idle: bool,
}

/// The viewer leaves too many control frames unread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Unread;

/// Whether a message may wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Room {
    /// It may.
    Free,
    /// The other messages leave no room for it now.
    Full,
    /// It is longer than the budget.
    TooLong,
}

impl Topic {
    const fn new() -> Self {
        Self {
            messages: VecDeque::new(),
            bytes: 0,
            start_tag: 0,
            is_idle: true,
        }
    }

    fn finish_tag(&self) -> Option<u64> {
        let first = self.messages.front()?;
        Some(self.start_tag.saturating_add(cost(first) as u64))
    }
}

fn cost(frame: &Frame) -> usize {
    frame.len() + OVERHEAD_BYTES
}

impl Outbox {
    pub(crate) const fn new(budget_bytes: usize) -> Self {
        Self {
            budget_bytes,
            control: VecDeque::new(),
            control_bytes: 0,
            topics: BTreeMap::new(),
            waiting_bytes: 0,
            in_flight_bytes: 0,
            virtual_time: 0,
            displaced: 0,
        }
    }

    /// The bytes of all messages of topics, that in flight included.
    pub(crate) const fn bytes(&self) -> usize {
        self.waiting_bytes + self.in_flight_bytes
    }

    /// The messages that newer ones have displaced.
    pub(crate) const fn displaced(&self) -> u64 {
        self.displaced
    }

    /// Adds a control frame.
    ///
    /// # Errors
    ///
    /// [`Unread`]: the viewer has to be disconnected.
    pub(crate) fn control(&mut self, frame: Frame) -> Result<(), Unread> {
        self.control_bytes += cost(&frame);
        self.control.push_back(frame);
        match self.control_bytes <= CONTROL_BYTES {
            true => Ok(()),
            false => Err(Unread),
        }
    }

    /// Removes the messages that lose their room to a new message of a subscription.
    pub(crate) fn make_room(&mut self, id: SubscriptionId, frame_len: usize) -> Room {
        let len = frame_len + OVERHEAD_BYTES;
        if len > self.budget_bytes {
            return Room::TooLong;
        }
        while self.topic(id).bytes > 0 && self.topic(id).bytes + len > TOPIC_BYTES {
            self.displace(id);
        }
        while self.bytes() + len > self.budget_bytes {
            let own = self.topic(id).bytes + len;
            let largest = self.topics.iter().max_by_key(|(_, it)| it.bytes);
            match largest.map(|(id, it)| (*id, it.bytes)) {
                Some((other, bytes)) if bytes > own => self.displace(other),
                _ if own > len => self.displace(id),
                _ => {
                    self.displaced += 1;
                    return Room::Full;
                }
            }
        }
        Room::Free
    }

    /// Adds a message of a subscription, if there is [room](Self::make_room).
    pub(crate) fn push(&mut self, id: SubscriptionId, frame: Frame) -> Room {
        let room = self.make_room(id, frame.len());
        if room == Room::Free {
            let (len, now) = (cost(&frame), self.virtual_time);
            self.waiting_bytes += len;
            let topic = self.topic(id);
            if topic.is_idle {
                topic.is_idle = false;
                topic.start_tag = topic.start_tag.max(now);
            }
            topic.bytes += len;
            topic.messages.push_back(frame);
        }
        room
    }

    /// The next frame to write. The caller reports its end with [`written`](Self::written) before it takes another one.
    pub(crate) fn pop(&mut self) -> Option<Frame> {
        debug_assert_eq!(
            self.in_flight_bytes, 0,
            "the frame before was not reported as written"
        );
        if let Some(frame) = self.control.pop_front() {
            self.control_bytes -= cost(&frame);
            return Some(frame);
        }
        let tagged = self
            .topics
            .iter()
            .filter_map(|(id, it)| Some((it.finish_tag()?, *id)));
        let (finish_tag, id) = tagged.min()?;
        let frame = self.remove_oldest(id)?;
        self.virtual_time = finish_tag;
        let topic = self.topic(id);
        topic.start_tag = finish_tag;
        topic.is_idle = topic.messages.is_empty();
        self.in_flight_bytes = cost(&frame);
        Some(frame)
    }

    /// The frame that was taken last is written.
    pub(crate) const fn written(&mut self) {
        self.in_flight_bytes = 0;
    }

    /// Forgets the messages of a subscription that has ended.
    pub(crate) fn remove(&mut self, id: SubscriptionId) {
        if let Some(topic) = self.topics.remove(&id) {
            self.waiting_bytes -= topic.bytes;
        }
    }

    fn topic(&mut self, id: SubscriptionId) -> &mut Topic {
        self.topics.entry(id).or_insert_with(Topic::new)
    }

    fn displace(&mut self, id: SubscriptionId) {
        self.displaced += u64::from(self.remove_oldest(id).is_some());
    }

    fn remove_oldest(&mut self, id: SubscriptionId) -> Option<Frame> {
        let topic = self.topics.get_mut(&id)?;
        let frame = topic.messages.pop_front()?;
        topic.bytes -= cost(&frame);
        self.waiting_bytes -= cost(&frame);
        Some(frame)
    }
}

#[cfg(test)]
mod tests;
