//! Runs one end of a link of the ring lane, in any role, while each access to a word answers as
//! fuzz input says. A load, a swap and a take of one word need not agree with each other.
//!
//! Most answers are those of a memory where a peer writes correct words, so that a run gets past
//! the first message.

mod cells;
mod hostile;
mod peer;

use alloc::{collections::BTreeSet, vec::Vec};
use core::cell::Cell;

use self::hostile::Hostile;
use super::{super::wire::LANE_RING, LANE_SOCKET, LINK, World};
use crate::{
    Code, FdFacts, Instant, Period, Seals,
    fuzz::Script,
    limits::SLOT_HEAD,
    link::{
        At, Body, Config, Delivery, Error, Fate, Input, LentRing, MaxLen, Misuse, NoDelivery,
        OutboundMessage, Payload, Publications, RingLayout, Role, SegmentInfo, SlotHead, SlotRange,
        Status,
        wire::{Frame, Open},
    },
};

const SLOTS: u32 = 4;

const fn segment(id: u32) -> SegmentInfo {
    SegmentInfo {
        id,
        stride: 4_096,
        slots: SLOTS,
    }
}

/// Runs the steps that the bytes encode. Panics if the machine broke its contract.
//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-007, SM2-RNG-008, SM2-RNG-010, SM2-RNG-011 fuzz
pub(crate) fn words(data: &[u8]) {
    let mut script = Script::new(data);
    let Some(mut ring) = Ring::new(&mut script) else {
        return;
    };
    while ring.step(&mut script).is_some() {
        ring.drain();
    }
    ring.world.input(Input::Eof);
    ring.drain();
    assert!(ring.world.pending.is_empty());
    ring.take_all();
}

/// One end with its rings, and the state that lets its peer be right most of the time.
struct Ring<'a> {
    world: World,
    /// The ring into which this end puts words; unused by a receiver.
    outgoing: Hostile<'a>,
    /// The ring that this end takes words from; unused by a sender.
    incoming: Hostile<'a>,
    /// The messages that the application holds.
    held: Vec<Delivery>,
    /// Caller: the calls without an outcome. Server: the calls without a reply.
    calls: BTreeSet<u64>,
    /// How many forward words the peer has put.
    put: u64,
    given_back: u64,
    /// The words that the machine put and the peer took.
    taken: Vec<u64>,
    /// The last id that the peer used.
    id: u64,
}

impl<'a> Ring<'a> {
    /// Creates an open link with its rings and with attached segments.
    fn new(script: &mut Script<'a>) -> Option<Self> {
        let flags = script.byte()?;
        let config = Config {
            id: LINK,
            version: 1,
            role: match flags & 9 {
                0 => Role::Sender,
                1 => Role::Receiver,
                8 => Role::Caller,
                _ => Role::Server,
            },
            reliable: flags & 2 != 0,
            sealed: false,
            ring: true,
            depth: 1 + u16::from(script.byte()? % 4),
            max_borrowed: 1 + u16::from(script.byte()? % 3),
            max_len: match flags & 16 {
                0 => MaxLen::GREATEST,
                _ => MaxLen::LEAST,
            },
            deadline: Period::NONE,
            lifespan: Period::NONE,
            lease: Period::NONE,
            publications: Publications::UNKNOWN,
        };
        let window = u32::from(config.depth + config.max_borrowed);
        let layout = RingLayout::new(config.depth, window)?;
        let len = usize::from(script.byte()?);
        // Answers are read from the front of the bytes, operations from the bytes after them.
        let answers = script.at_most(len);
        let sent = match config.role {
            Role::Sender => answers.len(),
            Role::Receiver => 0,
            Role::Caller | Role::Server => answers.len() / 2,
        };
        let (outgoing, incoming) = answers.split_at(sent);
        let stubborn = flags & 4 != 0;
        let mut ring = Self {
            world: World::with(config),
            outgoing: Hostile::new(layout, outgoing, stubborn),
            incoming: Hostile::new(config.ring_layout().unwrap_or(layout), incoming, stubborn),
            held: Vec::new(),
            calls: BTreeSet::new(),
            put: 0,
            given_back: 0,
            taken: Vec::new(),
            id: 0,
        };
        ring.open(window);
        Some(ring)
    }

    fn role(&self) -> Role {
        self.world.link.config().role
    }

    fn open(&mut self, window: u32) {
        let role = self.role();
        let open = Frame::Open(Open {
            role: role.counterpart() as u8,
            version: 1,
            window: if role.sends() { window } else { 0 },
            link: LINK,
            lanes: LANE_SOCKET | LANE_RING,
            max_len: if role.sends() { window } else { 0 },
            publications: Publications::UNKNOWN,
        });
        self.world.frame(&open, &[]);
        if role.sends() {
            let facts = FdFacts {
                regular: true,
                size_bytes: self.outgoing.layout.size_bytes(),
                seals: Seals::RING,
            };
            let depth = self.outgoing.layout.depth();
            self.world.frame(&Frame::Ring { depth, window }, &[facts]);
            self.world.input(Input::Attach(segment(0)));
            self.world.input(Input::Attach(segment(1)));
        }
        if role != Role::Sender {
            self.attached(0);
            self.attached(1);
        }
        assert!(self.world.link.is_open());
    }

    /// Whether the next operation is about the ring through which this end sends.
    fn is_outgoing(&self, script: &mut Script<'_>) -> Option<bool> {
        match self.role() {
            Role::Sender => Some(true),
            Role::Receiver => Some(false),
            Role::Caller | Role::Server => Some(script.byte()? % 2 == 0),
        }
    }

    fn step(&mut self, script: &mut Script<'_>) -> Option<()> {
        let choice = script.byte()? % 16;
        let is_outgoing = self.is_outgoing(script)?;
        match choice {
            0..=3 if is_outgoing => self.send(script)?,
            4 if is_outgoing => self.send_in_cell(script)?,
            5 | 6 if is_outgoing => self.harvest(),
            7..=9 if is_outgoing => self.peer_takes(script)?,
            10 if is_outgoing => self.segments(script)?,
            0..=4 => drop(self.take()),
            5 | 6 => self.release(script)?,
            7 | 8 => self.peer_puts(script)?,
            9 => self.peer_puts_cell(script)?,
            10 => self.peer_segments(script)?,
            11 => self.check_queries(),
            12 => {
                let words = [&self.incoming, &self.outgoing][usize::from(is_outgoing)];
                let at = match script.byte()? % 4 {
                    0 => At::ReceiverParked,
                    1 => At::SenderParked,
                    2 => At::Forward(u32::from(script.byte()?) % words.depth() as u32),
                    _ => At::Back(u32::from(script.byte()?) % words.layout.window()),
                };
                let bits = u64::from(script.byte()?) << (script.byte()? % 64);
                words.set(at, bits);
            }
            13 => self.world.input(Input::Blocked),
            14 => self.world.input(Input::Writable),
            _ => match script.byte()? {
                0xff => self.world.input(Input::Close(Code(0))),
                0xfe => self.world.input(Input::Eof),
                0xfd => self.world.input(Input::SegmentMissing),
                0xf0..=0xfc => self.cancel(script)?,
                _ => self.world.frame(&Frame::Doorbell, &[]),
            },
        }
        Some(())
    }

    /// Drains the machine, and checks its outputs about calls.
    fn drain(&mut self) {
        self.world.drain();
        for call in self.world.failed.drain(..) {
            assert!(self.calls.remove(&call), "a call ends once");
        }
        for call in self.world.cancelled.drain(..) {
            assert!(self.calls.contains(&call), "it has no reply");
        }
    }

    /// After the end: takes the messages that are left in the ring. Then every call must have an
    /// outcome.
    fn take_all(&mut self) {
        let last = loop {
            for delivery in self.held.drain(..) {
                let _ = (self.world.link).release(&self.incoming, delivery.sequence);
                self.incoming.check_accesses(3);
            }
            let taken = self.take();
            if !matches!(taken, Ok(true)) {
                break taken;
            }
        };
        if last == Err(NoDelivery::UnknownSegment) {
            self.world.input(Input::SegmentMissing);
        }
        self.drain();
        if self.role() == Role::Caller {
            assert_eq!(self.calls, BTreeSet::new(), "after {last:?}");
        }
    }

    /// Usually the id of one of the calls.
    fn some_call(&self, script: &mut Script<'_>) -> Option<u64> {
        let pick = script.below(8)? % self.calls.len().max(1);
        let right = self.calls.iter().nth(pick).copied();
        script.near(right.unwrap_or(self.id))
    }

    fn cancel(&mut self, script: &mut Script<'_>) -> Option<()> {
        let call = self.some_call(script)?;
        match self.role() {
            Role::Caller => self.world.input(Input::Cancel { call }),
            // This CANCEL can come before its request is taken.
            _ => {
                let call = call.wrapping_add(u64::from(script.byte()? % 2));
                self.world.frame(&Frame::Cancel { call }, &[]);
            }
        }
        Some(())
    }

    /// Bounds the accesses of a call to the outgoing ring: one attempt for each queued message. An attempt looks for
    /// room, takes the oldest message out, reads and clears each back word, looks at each cell once, and at one of them
    /// a second time; it reads, clears, writes and fills the cell of its message, and rings the bell.
    fn most_to_send(&self) -> u64 {
        let waiting = self.world.pending.len() as u64;
        let (depth, window) = (self.outgoing.depth(), self.outgoing.window());
        (2 * window + depth + 9) * (2 + 2 * waiting)
    }

    fn send(&mut self, script: &mut Script<'_>) -> Option<()> {
        self.world.own += 1;
        let key = self.world.own;
        let role = self.role();
        let message = OutboundMessage {
            key,
            id: match role {
                Role::Server => self.some_call(script)?,
                _ => script.near(key)?,
            },
            time: Instant(0),
            status: Status::Ok,
            len: script.near(100)?,
            body: Body::Pooled {
                segment: segment(script.below(3)? as u32),
                slot: script.below(SLOTS as u8 + 1)? as u32,
            },
        };
        let before = self.world.link.clone();
        let most = self.most_to_send();
        let mut settled = Vec::new();
        let note = |key, fate| settled.push((key, fate));
        let result = (self.world.link).send(&self.outgoing, message.clone(), note);
        self.outgoing.check_accesses(most);
        let is_sent = match result {
            Ok(_) => true,
            Err(Error::Misuse(misuse)) => {
                assert_eq!(self.world.link, before, "misuse changes nothing: {misuse}");
                false
            }
            // This call ended the link, and the outputs settled this message with all others.
            Err(Error::Ended(_)) if before.end().is_none() => true,
            Err(Error::Ended(end)) => {
                assert_eq!(before.end(), Some(end));
                false
            }
        };
        if is_sent {
            assert!(self.world.pending.insert(key));
            match role {
                Role::Caller => assert!(self.calls.insert(message.id), "ids grow"),
                Role::Server => assert!(self.calls.remove(&message.id), "it had no reply"),
                Role::Sender | Role::Receiver => {}
            }
        }
        assert!(
            settled.iter().all(|it| it.0 != key),
            "it was not put before"
        );
        self.settle(&settled);
        Some(())
    }

    fn harvest(&mut self) {
        let most = self.most_to_send();
        let mut settled = Vec::new();
        let note = |key, fate| settled.push((key, fate));
        let result = self.world.link.harvest(&self.outgoing, note);
        assert!(!matches!(result, Err(Error::Misuse(_))));
        self.outgoing.check_accesses(most);
        assert!(settled.iter().all(|it| it.1 == Fate::Delivered));
        self.settle(&settled);
    }

    fn settle(&mut self, settled: &[(u64, Fate)]) {
        for (key, _) in settled {
            assert!(self.world.pending.remove(key), "settled once");
        }
        self.drain();
    }

    fn segments(&mut self, script: &mut Script<'_>) -> Option<()> {
        let id = script.below(3)? as u32;
        let step = script.byte()? % 8;
        match step % 4 {
            0 => self.world.input(Input::Attach(segment(id))),
            1 => self.world.input(Input::Retire { segment: id }),
            2 => self.world.frame(&Frame::Detached { segment: id }, &[]),
            _ if step > 4 => self.world.input(Input::Drop(Fate::PoolLimit)),
            _ if id == 0 => self.world.input(Input::Drop(Fate::TooLong)),
            _ => self.world.input(Input::Drop(Fate::Overwritten)),
        }
        Some(())
    }

    /// The head of the next message to this end, usually correct.
    fn next_head(&mut self) -> [u8; SLOT_HEAD] {
        let mut script = self.incoming.answers();
        let is_reply = self.role() == Role::Caller;
        let right = if is_reply {
            let pick = script.below(8).unwrap_or(0) % self.calls.len().max(1);
            self.calls.iter().nth(pick).copied().unwrap_or(self.id)
        } else {
            // A message in a cell can have the last id.
            self.id.saturating_add(1)
        };
        self.id = script.near(right).unwrap_or(right).min(1 << 60);
        let choice = if is_reply { script.byte() } else { None };
        let status = match choice {
            Some(0xf0..=0xf7) => Status::Failed,
            Some(0xf8..) => Status::Cancelled,
            _ => Status::Ok,
        };
        let most = (4_096 - SLOT_HEAD as u64) * u64::from(status.has_payload());
        let head = SlotHead {
            id: self.id,
            time: Instant(9),
            len: script.near(most).unwrap_or(0),
            status,
        };
        head.to_bytes()
    }

    /// Takes a message. Returns whether there was one.
    fn take(&mut self) -> Result<bool, NoDelivery> {
        let before = self.world.link.clone();
        let next = self.next_head();
        let copies = Cell::new(0);
        let head = |slot: SlotRange| {
            copies.set(copies.get() + 1);
            assert!(slot.stride == 4_096 && slot.offset < 4_096 * u64::from(SLOTS));
            Some(next)
        };
        let result = self.world.link.take(&LentRing::new(&self.incoming, head));
        assert!(copies.get() <= 1, "the head is copied once");
        // Two looks for the oldest message; then for each attempt a word is read and taken, and a cell is copied.
        self.incoming.check_accesses(8 * self.incoming.depth());
        let limit = usize::from(self.world.link.config().max_borrowed);
        match &result {
            Ok(Some(delivery)) => {
                assert!(delivery.len <= self.world.link.config().max_len.bytes());
                assert!(self.held.iter().all(|it| it.sequence < delivery.sequence));
                let is_held = match &delivery.payload {
                    Payload::Pooled { segment, offset } => {
                        assert!(self.held.len() < limit);
                        let size = self.world.mapped.get(segment).expect("it is attached");
                        assert!(offset + delivery.len + SLOT_HEAD as u64 <= *size);
                        assert!(self.held.iter().all(|it| it.payload != delivery.payload));
                        true
                    }
                    Payload::Cell(bytes) => {
                        assert_eq!(bytes.len() as u64, delivery.len);
                        assert_eq!(copies.get(), 0, "it has no slot");
                        self.id = self.id.max(delivery.id);
                        false
                    }
                    other => panic!("neither in a slot nor in a cell: {other:?}"),
                };
                match self.role() {
                    Role::Caller => assert!(self.calls.remove(&delivery.id), "it had no reply"),
                    // After the end, no client waits for a reply.
                    Role::Server if before.end().is_none() => {
                        assert!(self.calls.insert(delivery.id), "ids grow");
                    }
                    _ => {}
                }
                if is_held {
                    self.held.push(delivery.clone());
                }
            }
            Ok(None) => {}
            Err(NoDelivery::TooManyBorrowed(_)) => assert_eq!(self.held.len(), limit),
            Err(NoDelivery::UnknownSegment) => assert_eq!(self.world.link.end(), before.end()),
            Err(NoDelivery::Ended(end)) => {
                assert_eq!(self.world.link.end(), Some(*end));
                assert!(before.end().is_none_or(|first| first == *end));
            }
            Err(NoDelivery::Misuse(misuse)) => {
                assert!(self.role() == Role::Sender, "{misuse}");
            }
        }
        self.drain();
        result.map(|it| it.is_some())
    }

    fn release(&mut self, script: &mut Script<'_>) -> Option<()> {
        let pick = script.below(4)?;
        let right = self.held.get(pick).map_or(0, |it| it.sequence);
        let sequence = script.near(right)?;
        let at = self.held.iter().position(|it| it.sequence == sequence);
        let result = (self.world.link).release(&self.incoming, sequence);
        self.incoming.check_accesses(3);
        match result {
            Ok(_) => assert!(at.is_some()),
            Err(Error::Misuse(misuse)) => {
                assert!(at.is_none() && misuse == Misuse::NotBorrowed);
            }
            Err(Error::Ended(end)) => assert_eq!(self.world.link.end(), Some(end)),
        }
        if let Some(at) = at {
            self.held.remove(at);
        }
        Some(())
    }

    /// Calls the methods that change nothing.
    fn check_queries(&self) {
        let link = &self.world.link;
        link.has_room(&self.outgoing);
        self.outgoing.check_accesses(1);
        let _ = link.takes_cells(&self.outgoing);
        self.outgoing.check_accesses(1);
        let depth = self.incoming.depth();
        link.may_take(&self.incoming);
        self.incoming.check_accesses(2 * depth + 1);
        assert!(link.untaken(&self.incoming) as u64 <= depth);
        self.incoming.check_accesses(depth);
        let _ = link.made_room(&self.incoming);
        self.incoming.check_accesses(2);
        let parking = match self.role() {
            Role::Sender => &self.outgoing,
            _ => &self.incoming,
        };
        link.park(parking);
        link.unpark(parking);
        parking.check_accesses(2);
    }
}
