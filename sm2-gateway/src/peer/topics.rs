//! The messages for a peer, from the schedule to their streams.

use std::{collections::BTreeMap, time::Duration};

use bytes::Bytes;
use quinn_proto::{Connection, Dir, SendDatagramError};
use sm2_proto::{
    Instant,
    gateway::{
        Carried, Header, OfferId, StreamEnd,
        schedule::{self, Cause, Input, Output, Schedule, Terms},
    },
};

use super::{
    ahead::{Room, SHORT_BYTES},
    outgoing::{Outgoing, Written},
};
use crate::tally::{Tally, Whose};

/// The messages for one peer.
#[derive(Debug, Default)]
pub(super) struct Topics {
    schedule: Schedule,
    offers: BTreeMap<OfferId, Offer>,
    /// Those that are not started, by their keys.
    waiting: BTreeMap<u64, (OfferId, Message)>,
    /// Those in flight, by their offers.
    in_flight: BTreeMap<OfferId, InFlight>,
    last_key: u64,
    /// How many long messages were started.
    started: i32,
}

/// The priority of the streams of short messages; of longer ones the earlier goes first, also with what was lost of it.
const SHORT: i32 = 0;

/// How the messages of an offer go.
#[derive(Debug)]
struct Offer {
    terms: Terms,
    is_reliable: bool,
    /// When the last one was published.
    last: Option<Instant>,
}

#[derive(Debug)]
struct InFlight {
    key: u64,
    state: State,
}

/// What was lost is there, sent again, after so many round trips.
const RESENT_ROUND_TRIPS: u32 = 2;

#[derive(Debug)]
enum State {
    /// As long as the peer allows no more streams.
    NoStream(Message),
    Writing(Outgoing),
}

/// A message for a peer.
#[derive(Debug)]
pub(super) struct Message {
    pub(super) sequence: u64,
    pub(super) published: Instant,
    pub(super) payload: Bytes,
    /// Whether a newer one is there before this one, were it lost, could be sent again.
    pub(super) is_frequent: bool,
}

impl Topics {
    /// How the messages of an offer will go.
    pub(super) fn terms(&mut self, offer: OfferId, terms: Terms, is_reliable: bool) {
        let offered = Offer {
            terms,
            is_reliable,
            last: None,
        };
        self.offers.insert(offer, offered);
    }

    pub(super) fn change(&mut self, now: Instant, offer: OfferId, terms: Terms) {
        if let Some(it) = self.offers.get_mut(&offer) {
            let depth = it.terms.depth;
            it.terms = Terms { depth, ..terms };
            let terms = it.terms;
            // An offer that nobody wants is not open.
            let _ = self.schedule.handle(now, Input::Change { offer, terms });
        }
    }

    /// The peer wants it.
    pub(super) fn wanted(&mut self, now: Instant, offer: OfferId, depth: u16) {
        if let Some(it) = self.offers.get_mut(&offer) {
            it.terms.depth = depth;
            let terms = it.terms;
            let _ = self.schedule.handle(now, Input::Open { offer, terms });
        }
    }

    pub(super) fn unwanted(&mut self, now: Instant, offer: OfferId) {
        let _ = self.schedule.handle(now, Input::Close { offer });
    }

    pub(super) fn forget(&mut self, now: Instant, offer: OfferId) {
        self.unwanted(now, offer);
        self.offers.remove(&offer);
    }

    pub(super) fn tick(&mut self, now: Instant) {
        let _ = self.schedule.handle(now, Input::Tick);
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.schedule.deadline()
    }

    /// Whether anybody wants it. `rtt`: how long the way takes there and back.
    pub(super) fn offer(
        &mut self,
        now: Instant,
        offer: OfferId,
        mut message: Message,
        rtt: Duration,
    ) -> bool {
        if let Some(it) = self.offers.get_mut(&offer) {
            let last = it.last.replace(message.published);
            let is_soon = |last| message.published.since(last) < rtt * RESENT_ROUND_TRIPS;
            message.is_frequent = !it.is_reliable && last.is_some_and(is_soon);
        }
        let key = self.last_key + 1;
        let entry = schedule::Message {
            key,
            len_bytes: message.payload.len() as u64 + sm2_proto::gateway::HEADER_LEN as u64,
            published: message.published,
        };
        let input = Input::Message {
            offer,
            message: entry,
        };
        let is_wanted = self.schedule.handle(now, input).is_ok();
        if is_wanted {
            self.last_key = key;
            self.waiting.insert(key, (offer, message));
        }
        is_wanted
    }

    /// Whether nothing is to be written.
    pub(super) fn is_idle(&self) -> bool {
        self.waiting.is_empty() && self.in_flight.is_empty()
    }

    /// Writes what there is `room` for: the message whose turn it is first.
    pub(super) fn write(
        &mut self,
        now: Instant,
        connection: &mut Connection,
        room: &mut Room,
        tally: &mut Tally,
    ) {
        loop {
            self.drain(connection, tally);
            let Some(offer) = self.write_first(now, connection, room, tally) else {
                return;
            };
            let _ = self.schedule.handle(now, Input::Sent { offer });
        }
    }

    /// The offer of the first message that was written whole, if one was.
    fn write_first(
        &mut self,
        now: Instant,
        connection: &mut Connection,
        room: &mut Room,
        tally: &mut Tally,
    ) -> Option<OfferId> {
        let order: Vec<OfferId> = self.schedule.order().collect();
        for offer in order {
            let Some(in_flight) = self.in_flight.get_mut(&offer) else {
                continue;
            };
            match in_flight.write(offer, now, connection, room, &mut self.started) {
                // The peer takes no more of it, but perhaps of another.
                Written::Part => continue,
                Written::NoRoom => return None,
                Written::All => tally.count(Whose::Ours(offer), |it| it.sent += 1),
                Written::Stopped => tally.count(Whose::Ours(offer), |it| it.withdrawn += 1),
            }
            self.in_flight.remove(&offer);
            return Some(offer);
        }
        None
    }

    /// Does what the schedule says.
    pub(super) fn drain(&mut self, connection: &mut Connection, tally: &mut Tally) {
        while let Some(output) = self.schedule.poll() {
            match output {
                Output::Start { offer, key } => {
                    if let Some((_, message)) = self.waiting.remove(&key) {
                        let state = State::NoStream(message);
                        self.in_flight.insert(offer, InFlight { key, state });
                    }
                }
                Output::Drop { key, cause } => {
                    let Some((offer, _)) = self.waiting.remove(&key) else {
                        continue;
                    };
                    tally.count(Whose::Ours(offer), |it| match cause {
                        Cause::Superseded => it.superseded += 1,
                        Cause::Expired => it.expired += 1,
                        Cause::Withdrawn => it.withdrawn += 1,
                    });
                }
                Output::Reset { key } => {
                    self.in_flight.retain(|offer, in_flight| {
                        let is_it = in_flight.key == key;
                        if is_it {
                            tally.count(Whose::Ours(*offer), |it| it.withdrawn += 1);
                        }
                        if let (true, State::Writing(outgoing)) = (is_it, &in_flight.state) {
                            outgoing.reset(connection, StreamEnd::Withdrawn);
                        }
                        !is_it
                    });
                }
            }
        }
    }

    /// The connection is over.
    pub(super) fn end(&mut self, tally: &mut Tally) {
        let waiting = self.waiting.values().map(|(offer, _)| offer);
        for offer in waiting.chain(self.in_flight.keys()) {
            tally.count(Whose::Ours(*offer), |it| it.withdrawn += 1);
        }
        *self = Self {
            last_key: self.last_key,
            ..Self::default()
        };
    }
}

impl InFlight {
    fn write(
        &mut self,
        offer: OfferId,
        now: Instant,
        connection: &mut Connection,
        room: &mut Room,
        started: &mut i32,
    ) -> Written {
        if let State::NoStream(message) = &self.state {
            if room.left(message.payload.len()) == 0 {
                return Written::NoRoom;
            }
            if message.is_frequent
                && let Some(written) = message.send_datagram(offer, now, connection, room)
            {
                return written;
            }
        }
        self.open(offer, now, connection, started);
        let State::Writing(outgoing) = &mut self.state else {
            return Written::Part;
        };
        let written = outgoing.write(connection, room);
        if written == Written::Stopped {
            outgoing.reset(connection, StreamEnd::Withdrawn);
        }
        written
    }

    /// Opens the stream, as late as can be.
    fn open(
        &mut self,
        offer: OfferId,
        now: Instant,
        connection: &mut Connection,
        started: &mut i32,
    ) {
        let State::NoStream(message) = &self.state else {
            return;
        };
        let Some(stream) = connection.streams().open(Dir::Uni) else {
            return;
        };
        let priority = match message.payload.len() {
            ..=SHORT_BYTES => SHORT,
            _ => {
                *started = started.saturating_add(1);
                -*started
            }
        };
        // It was opened just now.
        let _ = connection.send_stream(stream).set_priority(priority);
        let header = message.header(offer, now);
        let outgoing = Outgoing::new(stream, &header, message.payload.clone());
        self.state = State::Writing(outgoing);
    }
}

impl Message {
    fn header(&self, offer: OfferId, now: Instant) -> Header {
        let age = now.since(self.published).as_nanos();
        Header {
            carried: Carried::Message {
                sequence: self.sequence,
                age_ns: u64::try_from(age).unwrap_or(u64::MAX),
            },
            offer,
            len: self.payload.len() as u64,
        }
    }

    /// Sends it without a stream, if it is short enough.
    //= SM2-GWM-003
    fn send_datagram(
        &self,
        offer: OfferId,
        now: Instant,
        connection: &mut Connection,
        room: &mut Room,
    ) -> Option<Written> {
        let head = self.header(offer, now).to_bytes();
        let len_bytes = head.len() + self.payload.len();
        if connection.datagrams().max_size()? < len_bytes {
            return None;
        }
        let bytes = [&head[..], &self.payload].concat();
        match connection.datagrams().send(bytes.into(), false) {
            Ok(()) => {
                room.take(len_bytes);
                Some(Written::All)
            }
            Err(SendDatagramError::Blocked(_)) => Some(Written::Part),
            Err(_) => None,
        }
    }
}
