//! One end of a link of the ring lane whose words answer what bytes decide, each access anew: a
//! load, a swap and a take need not agree with each other.
//!
//! Mostly the answers are those of a memory that a peer writes right words to, so that a run gets
//! past the first of them.

use alloc::{collections::BTreeMap, vec::Vec};
use core::cell::{Cell, RefCell};

use super::{super::wire::LANE_RING, LANE_SOCKET, LINK, NOW, World};
use crate::{
    Code, Datagram, FdFacts, Instant, Seals,
    fuzz::Script,
    limits::SLOT_HEAD,
    link::{
        At, Config, Delivery, EMPTY, Error, Fate, Input, Misuse, NoDelivery, Payload, RingLayout,
        RingMessage, Role, SegmentInfo, SlotHead, Status, Word, Words,
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

/// Runs what the bytes say. Panics if the machine broke a promise.
//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-007, SM2-RNG-008, SM2-RNG-011 fuzz
pub(crate) fn words(data: &[u8]) {
    let mut script = Script::new(data);
    let Some(mut ring) = Ring::new(&mut script) else {
        return;
    };
    while ring.step(&mut script).is_some() {
        ring.world.drain();
    }
    ring.world.input(Input::Eof);
    assert!(ring.world.pending.is_empty());
}

/// Words that lie.
struct Hostile<'a> {
    layout: RingLayout,
    /// By offset.
    memory: RefCell<BTreeMap<u64, u64>>,
    script: RefCell<Script<'a>>,
    accesses: Cell<u64>,
    /// Whether no exchange ever succeeds.
    stubborn: bool,
}

impl Hostile<'_> {
    fn offset(&self, at: At) -> u64 {
        self.layout.offset(at).expect("a word of the ring")
    }

    fn set(&self, at: At, bits: u64) -> u64 {
        let offset = self.offset(at);
        self.memory
            .borrow_mut()
            .insert(offset, bits)
            .unwrap_or(EMPTY)
    }

    /// What is there, or what the bytes say.
    fn answer(&self, right: u64) -> u64 {
        self.accesses.set(self.accesses.get() + 1);
        let mut script = self.script.borrow_mut();
        let mut lie = || {
            let kind = script.byte()?;
            Some(match kind {
                0xff => EMPTY,
                0xfe => u64::from(script.byte()?) << (script.byte()? % 64),
                0xfd => right ^ 1 << (script.byte()? % 64),
                // As if the other side were further, or less far.
                0xfc => right.wrapping_add(u64::from(script.byte()? % 32) << 32),
                0xfb => right.wrapping_sub(u64::from(script.byte()? % 32) << 32),
                _ => right,
            })
        };
        lie().unwrap_or(right)
    }
}

impl Words for Hostile<'_> {
    fn load(&self, at: At) -> u64 {
        let offset = self.offset(at);
        let right = self.memory.borrow().get(&offset).copied();
        self.answer(right.unwrap_or(EMPTY))
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        let right = self.set(at, bits);
        self.answer(right)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        let offset = self.offset(at);
        let there = self.memory.borrow().get(&offset).copied();
        let is_there = !self.stubborn && there.unwrap_or(EMPTY) == bits;
        let answer = self.answer(u64::from(is_there)) == 1;
        if answer {
            self.set(at, EMPTY);
        }
        answer
    }

    fn fence(&self) {}
}

/// One end with its ring, and what its peer needs to be right most of the time.
struct Ring<'a> {
    world: World,
    words: Hostile<'a>,
    /// What the application holds.
    held: Vec<Delivery>,
    /// How many words the peer has put, forward or back.
    put: u64,
    /// The words that the machine put and the peer took.
    taken: Vec<u64>,
    /// The last id that the peer used.
    id: u64,
}

impl<'a> Ring<'a> {
    /// Open, with its ring and with segments.
    fn new(script: &mut Script<'a>) -> Option<Self> {
        let flags = script.byte()?;
        let config = Config {
            id: LINK,
            version: 1,
            role: [Role::Sender, Role::Receiver][usize::from(flags & 1)],
            reliable: flags & 2 != 0,
            sealed: false,
            ring: true,
            depth: 1 + u16::from(script.byte()? % 4),
            max_borrowed: 1 + u16::from(script.byte()? % 3),
        };
        let window = u32::from(config.depth + config.max_borrowed);
        let layout = RingLayout::new(config.depth, window)?;
        let len = script.byte()?;
        let mut ring = Self {
            world: World::with(config),
            words: Hostile {
                layout,
                memory: RefCell::default(),
                // The answers are spent from the front, the operations from behind these.
                script: RefCell::new(Script::new(script.at_most(usize::from(len)))),
                accesses: Cell::new(0),
                stubborn: flags & 4 != 0,
            },
            held: Vec::new(),
            put: 0,
            taken: Vec::new(),
            id: 0,
        };
        ring.open(window);
        Some(ring)
    }

    fn open(&mut self, window: u32) {
        let config = *self.world.link.config();
        let is_sender = config.role == Role::Sender;
        let open = Frame::Open(Open {
            role: config.role.counterpart() as u8,
            version: 1,
            window: if is_sender { window } else { 0 },
            link: LINK,
            lanes: LANE_SOCKET | LANE_RING,
        });
        self.world.frame(&open, &[]);
        if is_sender {
            let facts = FdFacts {
                regular: true,
                size_bytes: self.words.layout.size_bytes(),
                seals: Seals::RING,
            };
            let depth = config.depth;
            self.world.frame(&Frame::Ring { depth, window }, &[facts]);
            self.world.input(Input::Attach(segment(0)));
            self.world.input(Input::Attach(segment(1)));
        } else {
            self.attached(0);
            self.attached(1);
        }
        assert!(self.world.link.is_open());
    }

    fn attached(&mut self, id: u32) {
        let facts = FdFacts {
            regular: true,
            size_bytes: 4_096 * u64::from(SLOTS),
            seals: Seals::POOLED,
        };
        self.world.frame(&Frame::Attach(segment(id)), &[facts]);
    }

    fn step(&mut self, script: &mut Script<'_>) -> Option<()> {
        let choice = script.byte()? % 16;
        let is_sender = self.world.link.config().role == Role::Sender;
        match choice {
            0..=4 if is_sender => self.send(script)?,
            5 | 6 if is_sender => self.harvest(),
            7..=9 if is_sender => self.peer_takes(script)?,
            10 if is_sender => self.segments(script)?,
            0..=4 => self.take(),
            5 | 6 => self.release(script)?,
            7..=9 => self.peer_puts(script)?,
            10 => self.peer_segments(script)?,
            11 => self.look(),
            12 => {
                let at = match script.byte()? % 4 {
                    0 => At::ReceiverParked,
                    1 => At::SenderParked,
                    2 => At::Forward(u32::from(script.byte()?) % u32::from(self.depth())),
                    _ => At::Back(u32::from(script.byte()?) % self.words.layout.window()),
                };
                let bits = u64::from(script.byte()?) << (script.byte()? % 64);
                self.words.set(at, bits);
            }
            13 => self.world.input(Input::Blocked),
            14 => self.world.input(Input::Writable),
            _ => match script.byte()? {
                0xff => self.world.input(Input::Close(Code(0))),
                0xfe => self.world.input(Input::Eof),
                0xfd => self.world.link.ring_unknown_segment(),
                _ => self.world.frame(&Frame::Doorbell, &[]),
            },
        }
        Some(())
    }

    fn depth(&self) -> u16 {
        self.words.layout.depth()
    }

    /// How many accesses a call made: never more than the layout allows, whatever is there.
    fn check_accesses(&self, most: u64) {
        let accesses = self.words.accesses.take();
        assert!(accesses <= most, "{accesses} accesses, {most} at most");
    }

    fn window(&self) -> u64 {
        u64::from(self.words.layout.window())
    }

    fn send(&mut self, script: &mut Script<'_>) -> Option<()> {
        self.world.own += 1;
        let key = self.world.own;
        let message = RingMessage {
            key,
            id: script.near(key)?,
            len: script.near(100)?,
            segment: segment(script.below(3)? as u32),
            slot: script.below(SLOTS as u8 + 1)? as u32,
        };
        let before = self.world.link.clone();
        let mut settled = Vec::new();
        let note = |key, fate| settled.push((key, fate));
        let result = self.world.link.ring_send(&self.words, &message, note);
        self.check_accesses(2 * self.window() + 5);
        match result {
            Ok(_) => assert!(self.world.pending.insert(key)),
            Err(Error::Misuse(misuse)) => {
                assert_eq!(self.world.link, before, "misuse changes nothing: {misuse}");
            }
            // Whoever is told of the end is told of this message with all others.
            Err(Error::Ended(_)) if before.end().is_none() => {
                assert!(self.world.pending.insert(key));
            }
            Err(Error::Ended(end)) => assert_eq!(before.end(), Some(end)),
        }
        assert!(
            settled.iter().all(|it| it.0 != key),
            "it was not put before"
        );
        self.settle(&settled);
        Some(())
    }

    fn harvest(&mut self) {
        let mut settled = Vec::new();
        let note = |key, fate| settled.push((key, fate));
        let result = self.world.link.ring_harvest(&self.words, note);
        assert!(!matches!(result, Err(Error::Misuse(_))));
        self.check_accesses(2 * self.window());
        assert!(settled.iter().all(|it| it.1 == Fate::Delivered));
        self.settle(&settled);
    }

    fn settle(&mut self, settled: &[(u64, Fate)]) {
        for (key, _) in settled {
            assert!(self.world.pending.remove(key), "settled once");
        }
        self.world.drain();
    }

    /// The peer takes what is at some index, or gives back what it took.
    fn peer_takes(&mut self, script: &mut Script<'_>) -> Option<()> {
        let index = u32::from(script.byte()?) % u32::from(self.depth());
        let bits = self.words.set(At::Forward(index), EMPTY);
        if script.rarely()? {
            // It will say that it had it, and leaves it where it is.
            self.words.set(At::Forward(index), bits);
        }
        if bits != EMPTY {
            self.taken.push(bits);
        }
        if script.byte()? % 2 == 0 && !self.taken.is_empty() {
            let pick = script.below(8)? % self.taken.len();
            let back = (self.put % self.window()) as u32;
            self.words.set(At::Back(back), self.taken.swap_remove(pick));
            self.put += 1;
        }
        Some(())
    }

    fn segments(&mut self, script: &mut Script<'_>) -> Option<()> {
        let id = script.below(3)? as u32;
        match script.byte()? % 4 {
            0 => self.world.input(Input::Attach(segment(id))),
            1 => self.world.input(Input::Retire { segment: id }),
            2 => self.world.frame(&Frame::Detached { segment: id }, &[]),
            _ => {
                let _ = self.world.link.ring_pass_over();
            }
        }
        Some(())
    }

    fn take(&mut self) {
        let before = self.world.link.clone();
        let id = &mut self.id;
        let mut script = self.words.script.borrow().clone();
        let mut copies = 0;
        let head = |_, offset: u64, stride: u64| {
            copies += 1;
            assert!(stride == 4_096 && offset < 4_096 * u64::from(SLOTS));
            *id = script.near(*id + 1).unwrap_or(*id + 1).min(1 << 60);
            let head = SlotHead {
                id: *id,
                time: Instant(9),
                len: script.near(4_096 - SLOT_HEAD as u64).unwrap_or(0),
                status: Status::Ok,
            };
            Some(head.to_bytes())
        };
        let result = self.world.link.ring_take(&self.words, head);
        assert!(copies <= 1, "the head is copied once");
        self.check_accesses(6 * u64::from(self.depth()));
        let limit = usize::from(self.world.link.config().max_borrowed);
        match result {
            Ok(Some(delivery)) => {
                assert!(self.held.len() < limit);
                let Payload::Pooled { segment, offset } = delivery.payload else {
                    panic!("it is pooled");
                };
                let size = self.world.mapped.get(&segment).expect("it is attached");
                assert!(offset + delivery.len + SLOT_HEAD as u64 <= *size);
                assert!(self.held.iter().all(|it| it.sequence < delivery.sequence));
                assert!(self.held.iter().all(|it| it.payload != delivery.payload));
                self.held.push(delivery);
            }
            Ok(None) => {}
            Err(NoDelivery::TooManyBorrowed(_)) => assert_eq!(self.held.len(), limit),
            Err(NoDelivery::UnknownSegment) => assert_eq!(self.world.link.end(), before.end()),
            Err(NoDelivery::Ended(end)) => {
                assert_eq!(self.world.link.end(), Some(end));
                assert!(before.end().is_none_or(|first| first == end));
            }
            Err(NoDelivery::Misuse(misuse)) => panic!("{misuse}"),
        }
    }

    fn release(&mut self, script: &mut Script<'_>) -> Option<()> {
        let pick = script.below(4)?;
        let right = self.held.get(pick).map_or(0, |it| it.sequence);
        let sequence = script.near(right)?;
        let at = self.held.iter().position(|it| it.sequence == sequence);
        let result = self.world.link.ring_release(&self.words, sequence);
        self.check_accesses(3);
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

    /// The peer puts the next word; often right.
    fn peer_puts(&mut self, script: &mut Script<'_>) -> Option<()> {
        let sequence = script.near(self.put + 1)?;
        let (segment, slot) = (
            script.below(3)? as u32,
            script.below(SLOTS as u8 + 1)? as u32,
        );
        let index = (sequence % u64::from(self.depth())) as u32;
        let word = Word::new(segment, slot, sequence)?;
        self.words.set(At::Forward(index), word.to_bits());
        self.put += 1;
        Some(())
    }

    fn peer_segments(&mut self, script: &mut Script<'_>) -> Option<()> {
        let id = script.below(3)? as u32;
        if script.byte()? % 2 == 0 {
            self.attached(id);
        } else if self.world.link.end().is_none() {
            let is_held = |it: &Delivery| matches!(it.payload, Payload::Pooled { segment, .. } if segment == id);
            let busy = self.held.iter().any(is_held);
            let bytes = Frame::Detach { segment: id }.to_vec();
            let datagram = Datagram::new(&bytes);
            let result = self.world.link.handle(NOW, Input::Datagram(datagram));
            assert!(!busy || result.is_err(), "it is held");
        }
        self.world.drain();
        Some(())
    }

    /// What changes nothing.
    fn look(&self) {
        let link = &self.world.link;
        let depth = u64::from(self.depth());
        link.ring_has_room(&self.words);
        self.check_accesses(1);
        link.ring_ready(&self.words);
        self.check_accesses(2 * depth + 1);
        assert!(link.ring_waiting(&self.words) as u64 <= depth);
        self.check_accesses(depth);
        link.ring_made_room(&self.words);
        self.check_accesses(2);
        link.ring_park(&self.words);
        link.ring_unpark(&self.words);
        self.check_accesses(2);
    }
}
