//! A pair of ends: what their applications do, and what must hold.

use std::collections::BTreeMap;

use bytes::Bytes;
use sm2_proto::{
    Datagram, Farewell, Machine,
    link::{
        Body, Config, Counters, Delivery, End, Error, Fate, Input, Link, NoMemory, OutboundMessage,
        Payload, Role, SegmentInfo, Status,
    },
};

use crate::{
    driver::{Driver, SLOTS, Sent, segment},
    link_support::{self, NOW, give_back, offer},
    ops::{Op, PairConfig},
};

pub(crate) struct Pair {
    ends: [Driver; 2],
    /// The id of the message in each slot, by the end that writes.
    memory: [BTreeMap<(u32, u32), u64>; 2],
    broken_off: bool,
}

impl Pair {
    pub(crate) fn topic(config: PairConfig) -> Self {
        Self::new(config, [Role::Sender, Role::Receiver])
    }

    pub(crate) fn service(config: PairConfig) -> Self {
        Self::new(
            PairConfig {
                reliable: true,
                ..config
            },
            [Role::Caller, Role::Server],
        )
    }

    fn new(config: PairConfig, roles: [Role; 2]) -> Self {
        let end = |at: usize| {
            let config = Config {
                reliable: config.reliable,
                sealed: config.sealed,
                depth: config.depth[at],
                max_borrowed: config.max_borrowed[at],
                ..link_support::config(roles[at])
            };
            Driver::new(Link::new(config))
        };
        let mut pair = Self {
            ends: [end(0), end(1)],
            memory: Default::default(),
            broken_off: false,
        };
        pair.drain(0);
        pair.drain(1);
        pair
    }

    pub(crate) fn step(&mut self, op: &Op) {
        match *op {
            Op::Send { end, form, pick } => self.send(end, form, pick),
            Op::Carry { end } => self.carry(end),
            Op::Take { end } => self.take(end),
            Op::Release { end, pick } => self.release(end, pick),
            Op::Cancel { pick } => self.cancel(pick),
            Op::Retire { end, segment } => self.retire(end, segment),
            Op::Full { end, full } => self.set_full(end, full),
            Op::Close { end, eof } => {
                self.broken_off = true;
                if eof {
                    self.feed(end, Input::Eof)
                } else {
                    self.close_end(end)
                }
            }
        }
    }

    // Actions of the applications.

    fn send(&mut self, end: usize, form: u8, pick: usize) {
        let link = &self.ends[end].link;
        if link.end().is_some() || !link.config().role.sends() {
            return;
        }
        let is_server = link.config().role == Role::Server;
        let open = &self.ends[end].open_calls;
        let id = if is_server {
            let Some(call) = open.iter().nth(pick).or(open.last()).copied() else {
                return;
            };
            call
        } else {
            self.ends[end].next_id += 1;
            self.ends[end].next_id
        };
        let room = self.expect_room(end);
        let link = &self.ends[end].link;
        assert_eq!(
            link.has_room(&NoMemory),
            room.is_ok(),
            "room as the plain list says"
        );
        if room.is_err() && link.config().reliable {
            if link.config().role == Role::Sender {
                self.feed(end, Input::Drop(Fate::NoRoom));
                self.ends[end].skipped += 1;
            }
            return;
        }
        let message = self.message(end, id, form);
        let at = &mut self.ends[end];
        if is_server {
            at.open_calls.remove(&id);
        } else if at.link.config().role == Role::Caller {
            at.open_calls.insert(id);
        }
        let slot = match &message.body {
            Body::Pooled { segment, slot } => Some((segment.id, *slot)),
            Body::Inline(_) | Body::Sealed => None,
        };
        at.sent.push(Sent {
            key: message.key,
            id,
            slot,
            left: false,
            fate: None,
        });
        let sent = offer(&mut self.ends[end].link, message);
        self.fed(end, sent);
        if let Err(Some(displaced)) = room {
            let fate = self.ends[end]
                .sent
                .iter()
                .find(|it| it.key == displaced)
                .unwrap()
                .fate;
            assert_eq!(
                fate,
                Some(Fate::Overwritten),
                "the oldest that waits is displaced"
            );
        }
    }

    /// By the plain list: is there room, and if not, what would be displaced?
    fn expect_room(&self, end: usize) -> Result<(), Option<u64>> {
        let (this, other) = (&self.ends[end], &self.ends[1 - end]);
        let window = if this.link.is_open() {
            other.link.config().window() as usize
        } else {
            0
        };
        let depth = match this.link.config().role {
            Role::Sender | Role::Receiver => usize::from(this.link.config().depth),
            Role::Caller | Role::Server => 1024,
        };
        let unsettled = || this.sent.iter().filter(|it| it.fate.is_none());
        let unreleased = unsettled().filter(|it| it.left).count();
        let held = unsettled().filter(|it| !it.left);
        let waiting: Vec<u64> = held.skip(window - unreleased).map(|it| it.key).collect();
        if waiting.len() < depth || unsettled().count() < window {
            return Ok(());
        }
        Err(waiting.first().copied())
    }

    fn message(&mut self, end: usize, id: u64, form: u8) -> OutboundMessage {
        let at = &self.ends[end];
        let is_server = at.link.config().role == Role::Server;
        let status = match id % 5 {
            3 if is_server => Status::Cancelled,
            4 if is_server => Status::Failed,
            _ => Status::Ok,
        };
        let key = 1000 + at.sent.len() as u64;
        let payload = if status.has_payload() {
            content(id)
        } else {
            Bytes::new()
        };
        let len = payload.len() as u64;
        let body = match form {
            0 => self.free_slot(end).map(|(info, slot)| {
                self.memory[end].insert((info.id, slot), id);
                Body::Pooled {
                    segment: info,
                    slot,
                }
            }),
            1 => Some(Body::Sealed),
            _ => None,
        };
        let body = body.unwrap_or(Body::Inline(payload));
        OutboundMessage {
            key,
            id,
            time: NOW,
            status,
            len,
            body,
        }
    }

    fn free_slot(&self, end: usize) -> Option<(SegmentInfo, u32)> {
        let at = &self.ends[end];
        let is_free = |slot: &(u32, u32)| {
            !at.sent
                .iter()
                .any(|it| it.fate.is_none() && it.slot == Some(*slot))
        };
        if at.link.config().sealed {
            return None;
        }
        let mut slots = (0..3).flat_map(|id| (0..SLOTS).map(move |slot| (id, slot)));
        slots.find(is_free).map(|(id, slot)| (segment(id), slot))
    }

    fn take(&mut self, end: usize) {
        let at = &mut self.ends[end];
        if !at.link.config().role.receives() {
            return;
        }
        let limit = usize::from(at.link.config().max_borrowed);
        match at.link.take(&NoMemory) {
            Ok(Some(delivery)) => self.took(end, delivery),
            Ok(None) => assert_eq!(at.link.untaken(&NoMemory), 0),
            Err(_) => assert!(at.held.len() == limit && at.link.untaken(&NoMemory) > 0),
        }
        self.drain(end);
    }

    fn took(&mut self, end: usize, delivery: Delivery) {
        self.check_content(end, &delivery);
        let at = &mut self.ends[end];
        let role = at.link.config().role;
        let before = at
            .taken
            .last()
            .map_or(at.first_seen.unwrap(), |last| last + 1);
        let lost = if role == Role::Receiver {
            delivery.id - before
        } else {
            0
        };
        assert_eq!(delivery.lost, lost);
        assert!(at.held.len() < usize::from(at.link.config().max_borrowed));
        if role == Role::Server && at.link.end().is_none() {
            at.open_calls.insert(delivery.id);
        }
        at.taken.push(delivery.id);
        at.held.push(delivery);
    }

    /// The payload is the one that was sent under this id.
    fn check_content(&self, end: usize, delivery: &Delivery) {
        let at = &self.ends[end];
        match &delivery.payload {
            Payload::Inline(bytes) if delivery.status.has_payload() => {
                assert_eq!(*bytes, content(delivery.id));
            }
            Payload::Inline(bytes) => assert!(bytes.is_empty()),
            Payload::Pooled { segment, offset } => {
                let ended = at.ended || self.ends[1 - end].ended;
                let info = segment_of(at, *segment, ended);
                let slot = u32::try_from(offset / info.stride).unwrap();
                assert_eq!(offset % info.stride, 0);
                let written = self.memory[1 - end].get(&(*segment, slot));
                assert!(
                    ended || written == Some(&delivery.id),
                    "a slot was written while in use"
                );
            }
            Payload::Cell(_) => panic!("a cell on the socket lane"),
            Payload::Sealed => assert!(at.kept_files.contains(&delivery.sequence)),
        }
    }

    fn release(&mut self, end: usize, pick: usize) {
        let held = self.ends[end].held.len();
        if held == 0 {
            return;
        }
        let delivery = self.ends[end].held.remove(pick % held);
        self.check_content(end, &delivery);
        let released = give_back(&mut self.ends[end].link, delivery.sequence);
        self.fed(end, released);
    }

    fn cancel(&mut self, pick: usize) {
        let at = &self.ends[0];
        if at.link.config().role == Role::Caller
            && let Some(call) = at.open_calls.iter().nth(pick).copied()
        {
            self.feed(0, Input::Cancel { call });
        }
    }

    fn retire(&mut self, end: usize, segment: u32) {
        let at = &self.ends[end];
        let in_use = at
            .sent
            .iter()
            .any(|it| it.fate.is_none() && it.slot.is_some_and(|(id, _)| id == segment));
        if at.link.config().role.sends() && !in_use {
            self.feed(end, Input::Retire { segment });
        }
    }

    fn close_end(&mut self, end: usize) {
        self.feed(end, Input::Close(Farewell::Done.code()));
    }

    fn set_full(&mut self, end: usize, full: bool) {
        let at = &mut self.ends[end];
        at.full = full;
        if !full && let Some(packet) = at.kept.take() {
            at.put(&packet);
            self.feed(end, Input::Writable);
        }
    }

    /// The other end reads one datagram of this end.
    fn carry(&mut self, end: usize) {
        if self.ends[1 - end].ended {
            return;
        }
        match self.ends[end].wire.pop_front() {
            Some((bytes, fds)) => {
                self.notice(1 - end, &bytes);
                let datagram = Datagram {
                    bytes: &bytes,
                    fds: &fds,
                    ..Datagram::default()
                };
                self.feed(1 - end, Input::Datagram(datagram));
            }
            None if self.ends[end].ended => self.feed(1 - end, Input::Eof),
            None => {}
        }
    }

    fn notice(&mut self, end: usize, bytes: &[u8]) {
        if matches!(bytes[0], 4..=6) {
            let id = u64::from_le_bytes(bytes[24..32].try_into().unwrap());
            let at = &mut self.ends[end];
            at.first_seen.get_or_insert(id);
            if bytes[0] == 6 {
                assert!(at.open_calls.remove(&id), "one reply for each call");
            }
        }
    }

    fn feed(&mut self, end: usize, input: Input<'_>) {
        let result = self.ends[end].link.handle(NOW, input);
        self.fed(end, result);
    }

    /// An input or a call of the application was answered with this.
    #[track_caller]
    fn fed(&mut self, end: usize, result: Result<(), Error>) {
        match result {
            Ok(()) => {}
            Err(Error::Ended(_)) if self.ends[end].ended => {}
            Err(error) => panic!("end {end}: {error}"),
        }
        self.drain(end);
    }

    fn drain(&mut self, end: usize) {
        while let Some(output) = self.ends[end].link.poll() {
            self.ends[end].observe(output);
        }
    }

    pub(crate) fn check(&self) {
        for at in &self.ends {
            let tally = |fate| at.sent.iter().filter(|it| it.fate == fate).count() as u64;
            let expected = Counters {
                offered: at.sent.len() as u64 + at.skipped,
                delivered: tally(Some(Fate::Delivered)),
                overwritten: tally(Some(Fate::Overwritten)),
                discarded: tally(Some(Fate::Discarded)),
                no_room: at.skipped,
                closed: tally(Some(Fate::Closed)),
                too_long: tally(Some(Fate::TooLong)),
                expired: tally(Some(Fate::Expired)),
                in_flight: tally(None),
                ..Counters::default()
            };
            assert_eq!(at.link.counters(), expected);
            assert_eq!(at.link.in_flight() as u64, expected.in_flight);
            assert!(at.link.config().role == Role::Caller || at.taken.is_sorted_by(|a, b| a < b));
            assert_eq!(at.ended, at.link.end().is_some());
            assert!(!matches!(at.link.end(), Some(End::Violation(_))));
        }
    }

    /// Lets everything be finished: sockets open, applications willing.
    pub(crate) fn run_until_quiet(&mut self) {
        loop {
            let before = self.state();
            for end in [0, 1] {
                self.set_full(end, false);
                self.carry(end);
                self.take(end);
                self.release(end, 0);
                let at = &self.ends[end];
                if at.link.config().role == Role::Server && !at.open_calls.is_empty() {
                    self.send(end, 2, 0);
                }
                self.check();
            }
            if self.state() == before {
                return;
            }
        }
    }

    fn state(&self) -> [(Link, usize, bool); 2] {
        [0, 1].map(|end| {
            let at = &self.ends[end];
            (at.link.clone(), at.wire.len(), at.full)
        })
    }

    pub(crate) fn check_settled(&self) {
        for (this, other) in [(0, 1), (1, 0)].map(|(a, b)| (&self.ends[a], &self.ends[b])) {
            assert!(this.sent.iter().all(|it| it.fate.is_some()));
            assert_eq!((this.link.untaken(&NoMemory), this.held.len()), (0, 0));
            if self.broken_off {
                assert!(this.ended && (!self.is_caller(this) || this.calls_are_answered()));
                continue;
            }
            assert!(this.wire.is_empty() && this.link.is_open());
            assert!(this.link.calls() == 0 && this.open_calls.is_empty());
            let ids: Vec<u64> = this.sent.iter().map(|it| it.id).collect();
            let delivered = this
                .sent
                .iter()
                .filter(|it| it.fate == Some(Fate::Delivered));
            let delivered: Vec<u64> = delivered.map(|it| it.id).collect();
            assert_eq!(
                other.taken, delivered,
                "what was delivered is what was taken"
            );
            assert_eq!(delivered.last(), ids.last(), "keep-last keeps the newest");
            assert!(
                !this.link.config().reliable || delivered == ids,
                "reliable loses nothing"
            );
            let discarded = this
                .sent
                .iter()
                .filter(|it| it.fate == Some(Fate::Discarded))
                .count();
            assert_eq!(other.discards, discarded);
        }
    }

    fn is_caller(&self, at: &Driver) -> bool {
        at.link.config().role == Role::Caller
    }

    pub(crate) fn close(&mut self) {
        self.close_end(1);
        self.run_until_quiet();
    }

    pub(crate) fn check_closed(&self) {
        assert!(
            self.ends
                .iter()
                .all(|it| it.ended && it.link.in_flight() == 0)
        );
        if !self.broken_off {
            let done = Farewell::Done.code();
            assert_eq!(self.ends[1].link.end(), Some(End::Local(done)));
            assert_eq!(self.ends[0].link.end(), Some(End::Peer(done)));
        }
    }
}

fn segment_of(at: &Driver, id: u32, ended: bool) -> SegmentInfo {
    at.mapped.get(&id).copied().unwrap_or_else(|| {
        assert!(
            ended,
            "the segment of a message that is held stays attached"
        );
        segment(id)
    })
}

fn content(id: u64) -> Bytes {
    Bytes::from(format!("message {id}"))
}
