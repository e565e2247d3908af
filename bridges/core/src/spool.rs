//! Messages of durable topics on their way to a network that is away at times: a pure machine.

mod limits;

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use sm2_proto::Instant;

pub use self::limits::{Limits, LimitsError};
use crate::REORDER_MAX;

/// How many messages are in flight at most.
const MESSAGES_MAX: usize = REORDER_MAX as usize;

/// The number of a message in a spool: each is greater than those before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id(pub u64);

/// The messages of durable topics from the moment when they are offered until their [`Fate`].
///
/// A message is *spooled*, which means that it waits in a store of the caller, or *in flight*, which means that the
/// network has it and may still lose it.
///
/// | event | a spooled message | a message in flight |
/// | --- | --- | --- |
/// | [`poll`](Self::poll), if the network, window and rate allow it | the oldest one is sent | |
/// | [`acknowledge`](Self::acknowledge) | handed over by an attempt before an outage | handed over |
/// | [`reject`](Self::reject) | refused | refused |
/// | [`disconnect`](Self::disconnect) | | spooled again, in the old order |
/// | the oldest one in flight was sent `retry` ago | | all of them are spooled again |
/// | older than `max_age`, or the oldest one without room | expired | |
///
/// # Contract
///
/// | to do | methods |
/// | --- | --- |
/// | inspect | [`counts`](Self::counts), `spooled_bytes`, `in_flight_bytes` |
/// | feed | `restore`, [`offer`](Self::offer), `connect`, `disconnect`, `acknowledge`, `reject` |
/// | drain | [`poll`](Self::poll) until it returns `None`, after each event |
/// | deadline | [`deadline`](Self::deadline): call `poll` then |
///
/// # Guarantees
///
/// - At any time `offered = handed over + expired + refused + spooled + in flight`.
/// - Spooled messages have at most `max_bytes`, and messages in flight at most `window_bytes`.
/// - At most [`REORDER_MAX`](crate::REORDER_MAX) messages are in flight, so that [`Duplicates`](crate::Duplicates)
///   recognizes each message that is sent a second time.
/// - In any period, at most `window_bytes` and `rate_bytes_per_s` times the period are sent.
/// - Messages are sent in the order in which they were offered; those that were in flight, and are spooled again, come
///   first.
#[derive(Debug)]
pub struct Spool {
    limits: Limits,
    is_connected: bool,
    next: Id,
    /// Oldest first.
    spooled: VecDeque<Entry>,
    spooled_bytes: u64,
    /// In the order in which they were sent, which is that of their numbers.
    in_flight: VecDeque<Sent>,
    in_flight_bytes: u64,
    /// Messages with a fate that the caller does not know yet.
    ended: VecDeque<(Id, Fate)>,
    /// The time when all that was sent fits into the rate: sending may run ahead of it by a window.
    paid_until: Instant,
    offered: u64,
    handed_over: u64,
    expired: u64,
    refused: u64,
}

/// The end of a message's way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// The network has it.
    HandedOver,
    /// It was too old, or the oldest one when there was no room.
    Expired,
    /// It is too long, or the network does not take it.
    Refused,
}

/// A task for the caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Send this message to the network.
    Send(Id),
    /// This message has its fate: remove it from the store. A message that was refused when it was offered never was
    /// there.
    End(Id, Fate),
}

/// The account of a spool, in messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpoolCounts {
    /// All messages, those of [`restore`](Spool::restore) too.
    pub offered: u64,
    /// See [`Fate::HandedOver`].
    pub handed_over: u64,
    /// See [`Fate::Expired`].
    pub expired: u64,
    /// See [`Fate::Refused`].
    pub refused: u64,
    /// They wait.
    pub spooled: u64,
    /// They were sent, and have no fate yet.
    pub in_flight: u64,
}

impl SpoolCounts {
    /// Whether each message that was offered is in one other count.
    #[must_use]
    pub const fn is_balanced(&self) -> bool {
        self.offered
            == self.handed_over + self.expired + self.refused + self.spooled + self.in_flight
    }
}

impl fmt::Display for SpoolCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            offered,
            handed_over,
            expired,
            refused,
            spooled,
            in_flight,
        } = self;
        write!(
            f,
            "{offered} offered, {handed_over} handed over, {expired} expired, {refused} refused, {spooled} spooled, \
             {in_flight} in flight"
        )
    }
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    id: Id,
    len: u64,
    /// `None` if messages do not age.
    expires: Option<Instant>,
}

#[derive(Clone, Copy, Debug)]
struct Sent {
    entry: Entry,
    at: Instant,
}

impl Spool {
    /// An empty spool. The network is away until [`connect`](Self::connect).
    #[must_use]
    pub const fn new(limits: Limits) -> Self {
        Self {
            limits,
            is_connected: false,
            next: Id(0),
            spooled: VecDeque::new(),
            spooled_bytes: 0,
            in_flight: VecDeque::new(),
            in_flight_bytes: 0,
            ended: VecDeque::new(),
            paid_until: Instant(0),
            offered: 0,
            handed_over: 0,
            expired: 0,
            refused: 0,
        }
    }

    /// Takes a message of `len` bytes that the store still has from an earlier run. `age` is the time since it was
    /// offered. Call it for each of them, oldest first, before [`offer`](Self::offer).
    pub fn restore(&mut self, len: u64, age: Duration, now: Instant) -> Id {
        self.admit(len, age, now)
    }

    /// Takes a message of `len` bytes. The caller has it in its store until [`Output::End`].
    pub fn offer(&mut self, len: u64, now: Instant) -> Id {
        self.admit(len, Duration::ZERO, now)
    }

    fn admit(&mut self, len: u64, age: Duration, now: Instant) -> Id {
        let id = self.next;
        self.next = Id(id.0 + 1);
        self.offered += 1;
        if len > self.limits.window_bytes() {
            self.end(id, Fate::Refused);
        } else {
            let max_age = self.limits.max_age();
            let expires = max_age.map(|it| now.after(it.saturating_sub(age)));
            self.spooled.push_back(Entry { id, len, expires });
            self.spooled_bytes += len;
            self.expire(now);
        }
        self.check();
        id
    }

    /// The network is there.
    pub const fn connect(&mut self) {
        self.is_connected = true;
    }

    /// The network is away: what was in flight may be lost.
    pub fn disconnect(&mut self, now: Instant) {
        self.is_connected = false;
        self.take_back();
        self.expire(now);
        self.check();
    }

    /// Spools again all messages in flight.
    fn take_back(&mut self) {
        while let Some(sent) = self.in_flight.pop_back() {
            self.in_flight_bytes -= sent.entry.len;
            self.spooled_bytes += sent.entry.len;
            self.spooled.push_front(sent.entry);
        }
    }

    /// The network has acknowledged a message. Without effect for one that has its fate.
    pub fn acknowledge(&mut self, id: Id) {
        self.set_fate(id, Fate::HandedOver);
    }

    /// The network does not take a message, and never will. Without effect for one that has its fate.
    pub fn reject(&mut self, id: Id) {
        self.set_fate(id, Fate::Refused);
    }

    fn set_fate(&mut self, id: Id, fate: Fate) {
        if let Ok(index) = self.in_flight.binary_search_by_key(&id, |it| it.entry.id) {
            self.land(index, fate);
        } else if let Ok(index) = self.spooled.binary_search_by_key(&id, |it| it.id) {
            self.unspool(index, fate);
        }
        self.check();
    }

    /// The next task.
    pub fn poll(&mut self, now: Instant) -> Option<Output> {
        if self.retries_at().is_some_and(|it| it <= now) {
            self.take_back();
        }
        self.expire(now);
        let output = match self.ended.pop_front() {
            Some((id, fate)) => Some(Output::End(id, fate)),
            None => self.send(now),
        };
        self.check();
        output
    }

    /// The time when [`poll`](Self::poll) has a task, unless an event comes before; not later than that.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        let times = [self.expires_at(), self.retries_at(), self.sends_at()];
        times.into_iter().flatten().min()
    }

    /// The account.
    #[must_use]
    pub fn counts(&self) -> SpoolCounts {
        SpoolCounts {
            offered: self.offered,
            handed_over: self.handed_over,
            expired: self.expired,
            refused: self.refused,
            spooled: self.spooled.len() as u64,
            in_flight: self.in_flight.len() as u64,
        }
    }

    /// The bytes of all spooled messages.
    #[must_use]
    pub const fn spooled_bytes(&self) -> u64 {
        self.spooled_bytes
    }

    /// The bytes of all messages in flight.
    #[must_use]
    pub const fn in_flight_bytes(&self) -> u64 {
        self.in_flight_bytes
    }

    /// Ends the oldest spooled messages while there is no room for all, and those that are too old.
    fn expire(&mut self, now: Instant) {
        while self.spooled_bytes > self.limits.max_bytes()
            || self.expires_at().is_some_and(|it| it <= now)
        {
            self.unspool(0, Fate::Expired);
        }
    }

    fn send(&mut self, now: Instant) -> Option<Output> {
        self.sends_at().filter(|it| *it <= now)?;
        let entry = self.spooled.pop_front()?;
        self.spooled_bytes -= entry.len;
        self.in_flight_bytes += entry.len;
        self.paid_until = self.limits.pay(self.paid_until.max(now), entry.len);
        self.in_flight.push_back(Sent { entry, at: now });
        Some(Output::Send(entry.id))
    }

    /// The earliest time to send the oldest spooled message: `None` while the network is away, or the window
    /// has no room.
    fn sends_at(&self) -> Option<Instant> {
        let len = self.spooled.front()?.len;
        let has_room = self.in_flight.len() < MESSAGES_MAX
            && self.in_flight_bytes + len <= self.limits.window_bytes();
        (self.is_connected && has_room).then(|| self.limits.earliest(self.paid_until, len))
    }

    /// The time when the oldest spooled message is too old.
    fn expires_at(&self) -> Option<Instant> {
        self.spooled.front()?.expires
    }

    /// The time when what is in flight counts as lost.
    fn retries_at(&self) -> Option<Instant> {
        let oldest = self.in_flight.front()?;
        Some(oldest.at.after(self.limits.retry()))
    }

    /// A message in flight has its fate.
    fn land(&mut self, index: usize, fate: Fate) {
        if let Some(sent) = self.in_flight.remove(index) {
            self.in_flight_bytes -= sent.entry.len;
            self.end(sent.entry.id, fate);
        }
    }

    /// A spooled message has its fate.
    fn unspool(&mut self, index: usize, fate: Fate) {
        if let Some(entry) = self.spooled.remove(index) {
            self.spooled_bytes -= entry.len;
            self.end(entry.id, fate);
        }
    }

    fn end(&mut self, id: Id, fate: Fate) {
        *match fate {
            Fate::HandedOver => &mut self.handed_over,
            Fate::Expired => &mut self.expired,
            Fate::Refused => &mut self.refused,
        } += 1;
        self.ended.push_back((id, fate));
    }

    /// Checks the invariants.
    fn check(&self) {
        debug_assert!(self.counts().is_balanced());
        debug_assert!(self.spooled_bytes <= self.limits.max_bytes());
        debug_assert!(self.in_flight_bytes <= self.limits.window_bytes());
        debug_assert!(self.is_connected || self.in_flight.is_empty());
    }
}
