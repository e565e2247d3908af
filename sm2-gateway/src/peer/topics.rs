//! The messages for a peer, from the schedule to their streams.

use std::collections::BTreeMap;

use bytes::Bytes;
use quinn_proto::{Connection, Dir};
use sm2_proto::{
    Instant,
    gateway::{
        Carried, Header, StreamEnd,
        schedule::{self, Cause, Input, Output, Schedule, Terms},
    },
};

use super::{
    Counts,
    outgoing::{Outgoing, Written},
};

/// The messages for one peer.
#[derive(Debug, Default)]
pub(super) struct Topics {
    schedule: Schedule,
    /// How the messages of each offer go.
    terms: BTreeMap<u64, Terms>,
    /// Those that are not started, by their keys.
    waiting: BTreeMap<u64, (u64, Message)>,
    /// Those in the making, by their offers.
    making: BTreeMap<u64, Making>,
    last_key: u64,
    /// How many long messages were started.
    started: i32,
}

/// Messages up to this length go before longer ones that QUIC has already.
const SHORT_BYTES: usize = 16 << 10;
/// The priority of their streams; of longer ones the earlier goes first, also with what was lost of it.
const SHORT: i32 = 0;

#[derive(Debug)]
struct Making {
    key: u64,
    state: State,
}

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
}

impl Topics {
    /// How the messages of an offer will go.
    pub(super) fn terms(&mut self, offer: u64, terms: Terms) {
        self.terms.insert(offer, terms);
    }

    pub(super) fn change(&mut self, now: Instant, offer: u64, terms: Terms) {
        if let Some(it) = self.terms.get_mut(&offer) {
            let depth = it.depth;
            *it = Terms { depth, ..terms };
            let terms = *it;
            // An offer that nobody wants is not open.
            let _ = self.schedule.handle(now, Input::Change { offer, terms });
        }
    }

    /// The peer wants it.
    pub(super) fn wanted(&mut self, now: Instant, offer: u64, depth: u16) {
        if let Some(terms) = self.terms.get_mut(&offer) {
            terms.depth = depth;
            let terms = *terms;
            let _ = self.schedule.handle(now, Input::Open { offer, terms });
        }
    }

    pub(super) fn unwanted(&mut self, now: Instant, offer: u64) {
        let _ = self.schedule.handle(now, Input::Close { offer });
    }

    pub(super) fn forget(&mut self, now: Instant, offer: u64) {
        self.unwanted(now, offer);
        self.terms.remove(&offer);
    }

    pub(super) fn tick(&mut self, now: Instant) {
        let _ = self.schedule.handle(now, Input::Tick);
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.schedule.deadline()
    }

    /// Whether anybody wants it.
    pub(super) fn offer(&mut self, now: Instant, offer: u64, message: Message) -> bool {
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

    /// Writes what there is `room` for, in bytes: the message whose turn it is first.
    pub(super) fn write(
        &mut self,
        now: Instant,
        connection: &mut Connection,
        room: &mut usize,
        counts: &mut Counts,
    ) {
        loop {
            self.drain(connection, counts);
            let Some(offer) = self.write_first(now, connection, room, counts) else {
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
        room: &mut usize,
        counts: &mut Counts,
    ) -> Option<u64> {
        let order: Vec<u64> = self.schedule.order().collect();
        for offer in order {
            let Some(making) = self.making.get_mut(&offer) else {
                continue;
            };
            making.open(offer, now, connection, &mut self.started);
            let State::Writing(outgoing) = &mut making.state else {
                continue;
            };
            match outgoing.write(connection, room) {
                // The peer takes no more of it, but perhaps of another.
                Written::Part if *room > 0 => continue,
                Written::Part => return None,
                Written::All => counts.sent += 1,
                Written::Stopped => {
                    counts.withdrawn += 1;
                    outgoing.reset(connection, StreamEnd::Withdrawn);
                }
            }
            self.making.remove(&offer);
            return Some(offer);
        }
        None
    }

    /// Does what the schedule says.
    fn drain(&mut self, connection: &mut Connection, counts: &mut Counts) {
        while let Some(output) = self.schedule.poll() {
            match output {
                Output::Start { offer, key } => {
                    if let Some((_, message)) = self.waiting.remove(&key) {
                        let state = State::NoStream(message);
                        self.making.insert(offer, Making { key, state });
                    }
                }
                Output::Drop { key, cause } => {
                    self.waiting.remove(&key);
                    match cause {
                        Cause::Superseded => counts.superseded += 1,
                        Cause::Expired => counts.expired += 1,
                        Cause::Withdrawn => counts.withdrawn += 1,
                    }
                }
                Output::Reset { key } => {
                    counts.withdrawn += 1;
                    self.making.retain(|_, making| {
                        let is_it = making.key == key;
                        if let (true, State::Writing(outgoing)) = (is_it, &making.state) {
                            outgoing.reset(connection, StreamEnd::Withdrawn);
                        }
                        !is_it
                    });
                }
            }
        }
    }

    /// The connection is over.
    pub(super) fn end(&mut self, counts: &mut Counts) {
        counts.withdrawn += (self.waiting.len() + self.making.len()) as u64;
        *self = Self {
            last_key: self.last_key,
            ..Self::default()
        };
    }
}

impl Making {
    /// Opens the stream, as late as can be.
    fn open(&mut self, offer: u64, now: Instant, connection: &mut Connection, started: &mut i32) {
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
        let age = now.since(message.published).as_nanos();
        let header = Header {
            carried: Carried::Message {
                sequence: message.sequence,
                age_ns: u64::try_from(age).unwrap_or(u64::MAX),
            },
            offer,
            len: message.payload.len() as u64,
        };
        let outgoing = Outgoing::new(stream, &header, message.payload.clone());
        self.state = State::Writing(outgoing);
    }
}
