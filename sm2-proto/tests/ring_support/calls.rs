//! The two ends of a link of a service on the ring lane: their applications, drivers and lists.
//!
//! The lists restate the rules of SPEC: the calls, their outcomes, and the slots that must not be
//! written.
#![allow(
    dead_code,
    unused_imports,
    reason = "tests and benchmarks use their parts"
)]

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::{
    Datagram, Instant, Machine,
    limits::SLOT_HEAD,
    link::{
        Body, CellMessage, Config, Delivery, EMPTY, Error, Fate, Input, LaneKind, LentRing, Link,
        Misuse, NoDelivery, OutboundMessage, Output, Packet, Payload, RingMemory, SlotHead,
        SlotRange, Status, Wake, doorbell,
    },
};

#[path = "calls/both.rs"]
mod both;

pub(crate) use self::both::Calls;
pub(crate) use crate::ring_support::world::segment;
use crate::{
    link_support::NOW,
    ring_support::content,
    ring_support::world::{SLOTS, World},
};

pub(crate) const CALLER: usize = 0;
pub(crate) const SERVER: usize = 1;

/// A message in its sender's list.
struct Sent {
    key: u64,
    id: u64,
    /// The segment and the slot; `None` if it is in a cell.
    place: Option<(u32, u32)>,
    /// Of a message in a slot: that of a message in a cell is only counted.
    fate: Option<Fate>,
}

impl Sent {
    /// True if the message has this slot, which must not be written.
    fn keeps(&self, place: (u32, u32)) -> bool {
        self.place == Some(place) && matches!(self.fate, None | Some(Fate::Closed))
    }
}

/// The outcome of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    Reply(Status),
    Failed,
}

/// One end of the link.
pub(crate) struct Side {
    end: usize,
    pub(crate) link: Link,
    kept: Option<Packet>,
    pub(crate) full: bool,
    pub(crate) ended: bool,
    /// True if the end waits for the doorbell.
    pub(crate) asleep: bool,
    sent: Vec<Sent>,
    pub(crate) held: Vec<Delivery>,
    /// All outputs except `Transmit` and `Settled`.
    pub(crate) outputs: Vec<Output>,
    /// Caller: its calls, with the outcome of each that has ended.
    pub(crate) calls: BTreeMap<u64, Option<Outcome>>,
    /// Server: the requests that it has taken.
    pub(crate) taken: Vec<u64>,
    pub(crate) owed: Vec<u64>,
    pub(crate) cancelled: BTreeSet<u64>,
}

impl Side {
    fn new(end: usize, config: Config) -> Self {
        Self {
            end,
            link: Link::new(config),
            kept: None,
            full: false,
            ended: false,
            asleep: false,
            sent: Vec::new(),
            held: Vec::new(),
            outputs: Vec::new(),
            calls: BTreeMap::new(),
            taken: Vec::new(),
            owed: Vec::new(),
            cancelled: BTreeSet::new(),
        }
    }

    /// Carries out the outputs of the link.
    pub(crate) fn drain(&mut self, world: &World) {
        while let Some(output) = self.link.poll() {
            let is_late = matches!(output, Output::CallFailed { .. });
            let is_close = self.link.end().is_some();
            assert!(
                !self.ended || is_late,
                "nothing comes after Ended: {output:?}"
            );
            match &output {
                Output::Transmit(_) if self.full && is_close => {}
                Output::Transmit(packet) if self.full => {
                    assert!(self.kept.replace(packet.clone()).is_none());
                    let _ = self.link.handle(NOW, Input::Blocked);
                }
                Output::Transmit(packet) => {
                    assert!(self.kept.is_none(), "nothing overtakes what is kept");
                    world.put(self.end, packet);
                }
                Output::Settled { key, fate } => self.settle(world, *key, *fate),
                Output::Cancelled { call } => {
                    assert!(self.owed.contains(call) && self.cancelled.insert(*call));
                }
                Output::CallFailed { call } => self.finish(*call, Outcome::Failed),
                Output::Ended(_) => (self.ended, self.kept) = (true, None),
                _ => {}
            }
            if !matches!(output, Output::Transmit(_) | Output::Settled { .. }) {
                self.outputs.push(output);
            }
        }
    }

    /// CALL-RING: a call ends exactly once.
    fn finish(&mut self, call: u64, outcome: Outcome) {
        let before = self.calls.insert(call, Some(outcome));
        assert_eq!(before, Some(None), "call {call}: {outcome:?}");
    }

    fn settle(&mut self, world: &World, key: u64, fate: Fate) {
        let sent = self.sent.iter_mut().find(|it| it.key == key).unwrap();
        assert_eq!(sent.fate.replace(fate), None, "settled once");
        assert!(matches!(fate, Fate::Delivered | Fate::Closed), "{fate:?}");
        if fate == Fate::Delivered {
            // An end that wrongly still reads this slot sees garbage.
            let (segment, slot) = sent.place.expect("only messages in slots are settled");
            let place = (self.end, segment, slot);
            world.heads.borrow_mut().insert(place, [0xaa; SLOT_HEAD]);
        }
    }

    /// Sends a doorbell. If the socket is full, it is dropped: the other end has a datagram to read
    /// anyway.
    fn ring_the_bell(&self, world: &World) {
        if !self.full || !world.is_readable(1 - self.end) {
            let bell = (doorbell().to_vec(), vec![]);
            world.wires.borrow_mut()[self.end].push_back(bell);
        }
    }

    /// Returns a free slot, if possible the one that was used last.
    fn free_place(&self, within: u32) -> Option<(u32, u32)> {
        let places = (0..SLOTS).map(|slot| (within, slot));
        let is_free = |place: &(u32, u32)| !self.sent.iter().any(|it| it.keeps(*place));
        let last = |place: &(u32, u32)| self.sent.iter().rposition(|it| it.place == Some(*place));
        places.filter(is_free).max_by_key(last)
    }

    /// True if there is a slot in this segment. A message in a cell needs one in segment 0, where
    /// it is put if the ring is full.
    fn has_place(&self, within: Option<u32>) -> bool {
        self.free_place(within.unwrap_or(0)).is_some()
    }

    /// Makes the next call: in a slot of this segment, or in a cell.
    pub(crate) fn call(&mut self, words: &impl RingMemory, world: &World, within: Option<u32>) {
        if self.ended || !self.link.is_open() || !self.has_place(within) {
            return;
        }
        // Call numbers grow, but not always by one.
        let last = self.calls.last_key_value().map_or(0, |(id, _)| *id);
        let id = last + 1 + last % 2;
        self.calls.insert(id, None);
        self.send(words, world, id, Status::Ok, within);
    }

    /// Replies to one of the open calls.
    pub(crate) fn reply(
        &mut self,
        words: &impl RingMemory,
        world: &World,
        pick: usize,
        within: Option<u32>,
    ) {
        if self.owed.is_empty() || self.ended || !self.has_place(within) {
            return;
        }
        let id = self.owed.remove(pick % self.owed.len());
        let status = match (self.cancelled.remove(&id), id % 3) {
            (true, _) => Status::Cancelled,
            (false, 0) => Status::Failed,
            (false, _) => Status::Ok,
        };
        world.replied.borrow_mut().insert(id, status);
        self.send(words, world, id, status, within);
    }

    fn send(
        &mut self,
        words: &impl RingMemory,
        world: &World,
        id: u64,
        status: Status,
        within: Option<u32>,
    ) {
        if within.is_none() && self.send_in_cell(words, world, id, status) {
            return;
        }
        let place = (self.free_place(within.unwrap_or(0))).expect("was looked for");
        let head = SlotHead {
            id,
            time: Instant(0),
            len: u64::from(status.has_payload()) * (id % 7),
            status,
        };
        let slot = (self.end, place.0, place.1);
        world.heads.borrow_mut().insert(slot, head.to_bytes());
        let message = OutboundMessage {
            key: 1000 + self.sent.len() as u64,
            id,
            time: Instant(0),
            status: Status::Ok,
            len: head.len,
            body: Body::Pooled {
                segment: segment(place.0),
                slot: place.1,
            },
        };
        self.sent.push(Sent {
            key: message.key,
            id,
            place: Some(place),
            fate: None,
        });
        let mut settled = Vec::new();
        let sent = (self.link).send(words, message.clone(), |key, fate| {
            settled.push((key, fate))
        });
        self.sent_or_harvested(world, sent, &settled);
        self.send_due(words, world);
    }

    /// Sends a message in a cell. Returns false if it has to wait in a slot.
    //= SM2-RNG-013 test
    fn send_in_cell(
        &mut self,
        words: &impl RingMemory,
        world: &World,
        id: u64,
        status: Status,
    ) -> bool {
        let bytes = content(id);
        let message = CellMessage {
            id,
            time: Instant(id),
            status,
            bytes: if status.has_payload() { &bytes } else { &[] },
        };
        let is_idle = !self.link.has_queued() && self.link.in_flight() == 0 && !self.full;
        let mut settled = Vec::new();
        let sent = (self.link).send_in_cell(words, &message, |key, fate| settled.push((key, fate)));
        if sent == Err(Error::Misuse(Misuse::NoRoom)) {
            assert!(!is_idle && settled.is_empty());
            return false;
        }
        self.sent.push(Sent {
            key: 0,
            id,
            place: None,
            fate: None,
        });
        self.sent_or_harvested(world, sent, &settled);
        true
    }

    fn send_due(&mut self, words: &impl RingMemory, world: &World) {
        while self.link.is_due() {
            self.harvest_once(words, world);
        }
    }

    pub(crate) fn harvest(&mut self, words: &impl RingMemory, world: &World) {
        self.harvest_once(words, world);
        self.send_due(words, world);
    }

    fn harvest_once(&mut self, words: &impl RingMemory, world: &World) {
        if self.ended || !self.link.is_open() {
            return;
        }
        let mut settled = Vec::new();
        let result = (self.link).harvest(words, |key, fate| settled.push((key, fate)));
        self.sent_or_harvested(world, result, &settled);
    }

    fn sent_or_harvested(
        &mut self,
        world: &World,
        result: Result<Wake, Error>,
        settled: &[(u64, Fate)],
    ) {
        for (key, fate) in settled {
            self.settle(world, *key, *fate);
        }
        if result.expect("an honest pair").is_needed() {
            self.ring_the_bell(world);
        }
        self.drain(world);
    }

    /// Takes a message. Returns true if it is in a segment whose ATTACH was not read yet.
    pub(crate) fn take(&mut self, words: &impl RingMemory, world: &World) -> bool {
        let from = 1 - self.end;
        let copy = |slot: SlotRange| world.copy(from, slot.segment, slot.offset);
        let taken = self.link.take(&LentRing::new(words, copy));
        match taken {
            Ok(Some(delivery)) => {
                self.took(world, delivery);
                if self.link.made_room(words).is_needed() {
                    self.ring_the_bell(world);
                }
            }
            Ok(None) => {}
            Err(NoDelivery::TooManyBorrowed(it)) => {
                assert_eq!(self.held.len(), usize::from(it.max_borrowed));
            }
            Err(NoDelivery::UnknownSegment) => return true,
            Err(NoDelivery::Misuse(_)) => assert_ne!(self.link.lane(), LaneKind::Ring),
            Err(NoDelivery::Ended(end)) => panic!("an honest pair: {end}"),
        }
        self.drain(world);
        if self.ended && self.calls.values().any(|it| *it == Some(Outcome::Failed)) {
            self.check_nothing_left();
        }
        false
    }

    /// A call fails only when no reply is left in the ring.
    //= SM2-RNG-010 test
    fn check_nothing_left(&self) {
        assert_eq!(self.link.calls(), 0);
        let failed = (self.calls.iter()).filter(|(_, it)| **it == Some(Outcome::Failed));
        assert!(failed.count() > 0 && self.calls.values().all(Option::is_some));
    }

    fn took(&mut self, world: &World, delivery: Delivery) {
        let id = delivery.id;
        self.check_content(world, &delivery);
        assert_eq!(delivery.lost, 0);
        if self.end == SERVER {
            assert!(self.taken.last().is_none_or(|last| *last < id));
            self.taken.push(id);
            if !self.ended {
                self.owed.push(id);
            }
        } else {
            let status = world.replied.borrow()[&id];
            assert_eq!(delivery.status, status);
            self.finish(id, Outcome::Reply(status));
        }
        if !matches!(delivery.payload, Payload::Cell(_)) {
            self.held.push(delivery);
        }
    }

    /// Checks that the slot of a held message was not overwritten, or that a message in a cell is
    /// the one that was sent.
    pub(crate) fn check_content(&self, world: &World, delivery: &Delivery) {
        let id = delivery.id;
        match &delivery.payload {
            Payload::Pooled { segment, offset } => {
                let head = world.copy(1 - self.end, *segment, *offset).unwrap();
                assert_eq!(head[..8], id.to_le_bytes(), "{delivery:?}");
            }
            Payload::Cell(bytes) if delivery.status.has_payload() => {
                assert_eq!((&**bytes, delivery.time), (&*content(id), Instant(id)));
            }
            Payload::Cell(bytes) => assert!(bytes.is_empty() && delivery.len == 0),
            other => panic!("not on the ring lane: {other:?}"),
        }
    }

    pub(crate) fn release(&mut self, words: &impl RingMemory, world: &World, pick: usize) {
        if self.held.is_empty() {
            return;
        }
        let index = pick % self.held.len();
        let delivery = self.held.swap_remove(index);
        match self.link.release(words, delivery.sequence) {
            Ok(Wake::Needed) => self.ring_the_bell(world),
            Ok(Wake::NotNeeded) => {}
            Err(error) => assert!(self.ended, "{error}"),
        }
        self.drain(world);
    }

    /// Cancels one of all calls ever made, open or not.
    pub(crate) fn cancel(&mut self, world: &World, pick: usize) {
        let Some(call) = self.calls.keys().rev().nth(pick).copied() else {
            return;
        };
        let result = self.link.handle(NOW, Input::Cancel { call });
        assert!(result.is_ok() || self.ended, "{result:?}");
        self.drain(world);
    }

    pub(crate) fn retire(&mut self, world: &World, segment: u32) {
        let is_used = |it: &Sent| {
            let is_there = it.place.is_some_and(|place| place.0 == segment);
            is_there && it.fate.is_none()
        };
        if !self.sent.iter().any(is_used) {
            let _ = self.link.handle(NOW, Input::Retire { segment });
            self.drain(world);
        }
    }

    pub(crate) fn set_full(&mut self, world: &World, full: bool) {
        self.full = full;
        if !full && let Some(packet) = self.kept.take() {
            world.put(self.end, &packet);
            self.asleep = false;
            let _ = self.link.handle(NOW, Input::Writable);
            self.drain(world);
        }
    }

    /// Reads one datagram, or sees that the other end has closed.
    pub(crate) fn read(&mut self, world: &World, is_over: bool) {
        if self.ended {
            return;
        }
        let next = world.wires.borrow_mut()[1 - self.end].pop_front();
        let result = match &next {
            Some((bytes, fds)) => {
                let datagram = Datagram {
                    bytes,
                    fds,
                    ..Datagram::default()
                };
                self.link.handle(NOW, Input::Datagram(datagram))
            }
            None if is_over => self.link.handle(NOW, Input::Eof),
            None => return,
        };
        assert_eq!(result, Ok(()), "an honest pair");
        // Any readable datagram wakes the end.
        self.asleep = false;
        self.drain(world);
    }

    pub(crate) fn close(&mut self, world: &World, how: Input<'_>) {
        let _ = self.link.handle(NOW, how);
        self.drain(world);
        (self.full, self.kept) = (false, None);
    }

    /// Returns true if the end can do something without reading its socket.
    pub(crate) fn has_work(&self, world: &World) -> bool {
        let (incoming, outgoing) = (&world.rings[self.end], &world.rings[1 - self.end]);
        let mut probe = (self.link.clone(), outgoing.clone());
        let before = probe.1.forward();
        let _ = probe.0.harvest(&probe.1, |_, _| {});
        let put = (before.iter().zip(probe.1.forward())).any(|(a, b)| *a == EMPTY && b != EMPTY);
        put || self.link.may_take(incoming)
    }

    /// How many messages in slots are not settled.
    fn slots_in_flight(&self) -> usize {
        let in_flight = |it: &&Sent| it.place.is_some() && it.fate.is_none();
        self.sent.iter().filter(in_flight).count()
    }

    /// Checks how many messages are not settled. `taken` tells whether the other end has taken a
    /// message. If it was in a cell, it is still counted until this end sees that.
    //= SM2-RNG-013 test
    pub(crate) fn check_in_flight(&self, depth: usize, taken: impl Fn(u64) -> bool) {
        let in_flight = self.link.in_flight();
        if self.ended {
            assert_eq!(in_flight, 0);
            return;
        }
        let in_cells = self.sent.iter().filter(|it| it.place.is_none());
        let least = self.slots_in_flight() + in_cells.filter(|it| !taken(it.id)).count();
        assert!((least..=least + depth).contains(&in_flight));
    }
}
