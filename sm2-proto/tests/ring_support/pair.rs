//! A pair of ends of the ring lane, and the operations of a random run.

use std::cell::RefCell;

use sm2_proto::{
    Datagram, Farewell, Machine,
    link::{EMPTY, Error, Input, LentRing, Link, Misuse, RingLayout, Role},
};

use crate::{
    link_support::NOW,
    ring_support::between::Between,
    ring_support::ends::{Driver, Receiving, Sending, Sent, Shared},
    ring_support::{Memory, head, ring_config},
};

/// `within` is the segment of a message in a slot; `None` for a message in a cell.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Op {
    Send {
        within: Option<u32>,
    },
    /// While the sender sends, before one of its accesses, the receiver takes and releases.
    SendWhile {
        at: u32,
        takes: u8,
        within: Option<u32>,
    },
    /// While the receiver takes, before one of its accesses, the sender sends messages.
    TakeWhile {
        at: u32,
        sends: u8,
        within: Option<u32>,
    },
    /// While the receiver releases, the sender harvests and sends.
    ReleaseWhile {
        at: u32,
        sends: u8,
        pick: usize,
        within: Option<u32>,
    },
    Carry {
        end: usize,
    },
    Take,
    Release {
        pick: usize,
    },
    Harvest,
    Retire {
        segment: u32,
    },
    Full {
        end: usize,
        full: bool,
    },
    Park {
        end: usize,
    },
    Close {
        end: usize,
    },
    /// The process ends while it sends or takes, before the access with this index.
    Kill {
        end: usize,
        at: u32,
        within: Option<u32>,
    },
}

pub(crate) struct Pair {
    pub(crate) shared: Shared,
    pub(crate) sending: Sending,
    pub(crate) receiving: Receiving,
    pub(crate) depth: u64,
    pub(crate) reliable: bool,
    /// True if no end has closed, and no process has ended.
    pub(crate) sound: bool,
}

impl Pair {
    pub(crate) fn new(reliable: bool, depth: u16, max_borrowed: u16) -> Self {
        let end = |role| Driver::new(Link::new(ring_config(role, reliable, depth, max_borrowed)));
        let layout = RingLayout::new(depth, u32::from(depth + max_borrowed)).unwrap();
        let mut pair = Self {
            shared: Shared {
                words: Memory::new(layout),
                heads: RefCell::default(),
            },
            sending: Sending {
                at: end(Role::Sender),
                sent: Vec::new(),
                next_id: 0,
                skipped: 0,
                overwritten: 0,
            },
            receiving: Receiving {
                at: end(Role::Receiver),
                held: Vec::new(),
                taken: Vec::new(),
                taken_before_end: None,
                is_dead: false,
            },
            depth: u64::from(depth),
            reliable,
            sound: true,
        };
        pair.drain();
        pair
    }

    pub(crate) fn step(&mut self, op: Op) {
        let Self {
            shared,
            sending,
            receiving,
            ..
        } = self;
        let words = &shared.words;
        match op {
            Op::Send { within } => self.send(within),
            Op::SendWhile { at, takes, within } => {
                let between = Between::new(words, at, |words| {
                    for _ in 0..takes {
                        receiving.take(words, shared);
                        receiving.release(words, shared, 0);
                    }
                    false
                });
                sending.send(&between, shared, within);
            }
            Op::TakeWhile { at, sends, within } => {
                let between = Between::new(words, at, |words| {
                    (0..sends).for_each(|_| sending.send(words, shared, within));
                    false
                });
                receiving.take(&between, shared);
            }
            Op::ReleaseWhile {
                at,
                sends,
                pick,
                within,
            } => {
                let between = Between::new(words, at, |words| {
                    sending.harvest(words, shared);
                    (0..sends).for_each(|_| sending.send(words, shared, within));
                    false
                });
                receiving.release(&between, shared, pick);
            }
            Op::Carry { end } => self.carry(end),
            Op::Take => self.take(),
            Op::Release { pick } => receiving.release(words, shared, pick),
            Op::Harvest => self.harvest(),
            Op::Retire { segment } => self.retire(segment),
            Op::Full { end, full } => self.set_full(end, full),
            Op::Park { end } => self.park(end),
            Op::Close { end } => {
                self.sound = false;
                let close = Input::Close(Farewell::Done.code());
                let _ = self.end(end).link.handle(NOW, close);
            }
            Op::Kill { end, at, within } => self.kill(end, at, within),
        }
        self.drain();
    }

    fn end(&mut self, end: usize) -> &mut Driver {
        match end {
            0 => &mut self.sending.at,
            _ => &mut self.receiving.at,
        }
    }

    pub(crate) fn drain(&mut self) {
        self.sending.drain(&self.shared);
        let settled = self
            .receiving
            .at
            .drain(self.shared.words.layout.size_bytes());
        assert!(settled.is_empty());
        if self.receiving.at.ended {
            let taken = self.receiving.taken.len();
            self.receiving.taken_before_end.get_or_insert(taken);
        }
    }

    /// Sends a message with no operation in between, so that the result is known in advance.
    fn send(&mut self, within: Option<u32>) {
        let (sending, words) = (&mut self.sending, &self.shared.words);
        let before = (sending.sent.len(), sending.overwritten);
        let full = sending.at.link.in_flight() as u32 >= words.layout.window();
        let is_over = sending.at.ended || !sending.at.link.is_open() || sending.at.full;
        let no_index = words.forward()[(before.0 + 1) % self.depth as usize] != EMPTY;
        sending.send(words, &self.shared, within);
        let sent = sending.sent.len() > before.0;
        // If its segment is not attached, the message is passed over.
        if !is_over && sending.overwritten == before.1 {
            assert_eq!(sent, !self.reliable || !(full || no_index));
        }
    }

    /// Settles the messages that came back. After that, each message in a cell that was taken is
    /// settled.
    //= SM2-RNG-008, SM2-RNG-013 test
    pub(crate) fn harvest(&mut self) {
        self.sending.harvest(&self.shared.words, &self.shared);
        if self.sound && self.sending.at.link.is_open() {
            let expected = self.slots_in_flight() + self.cells_in_ring();
            assert_eq!(self.sending.at.link.in_flight(), expected);
        }
    }

    pub(crate) fn take(&mut self) {
        if self.receiving.take(&self.shared.words, &self.shared) && !self.receiving.at.ended {
            while !self.sending.at.wire.is_empty() {
                self.carry(0);
            }
            let again = self.receiving.take(&self.shared.words, &self.shared);
            assert!(
                !again || self.sending.at.kept.is_none(),
                "attached before it is used"
            );
        }
    }

    fn retire(&mut self, segment: u32) {
        let is_used = |it: &Sent| {
            let is_there = it.place.is_some_and(|place| place.0 == segment);
            is_there && it.fate.is_none()
        };
        let busy = self.sending.sent.iter().any(is_used);
        let link = &mut self.sending.at.link;
        match link.handle(NOW, Input::Retire { segment }) {
            Ok(()) => assert!(!busy),
            Err(Error::Misuse(misuse)) => assert!(busy && misuse == Misuse::SegmentBusy),
            Err(Error::Ended(_)) => assert!(self.sending.at.ended),
        }
    }

    pub(crate) fn set_full(&mut self, end: usize, full: bool) {
        let size_bytes = self.shared.words.layout.size_bytes();
        let at = self.end(end);
        at.full = full;
        if !full && let Some(packet) = at.kept.take() {
            at.put(&packet, size_bytes);
            at.asleep = false;
            let _ = at.link.handle(NOW, Input::Writable);
        }
    }

    /// Lets the other end read one datagram of this end, or see that this end has closed.
    pub(crate) fn carry(&mut self, end: usize) {
        if self.end(1 - end).ended {
            return;
        }
        let (next, is_over) = (self.end(end).wire.pop_front(), self.end(end).ended);
        let other = self.end(1 - end);
        let result = match next {
            Some((bytes, fds)) => {
                // Any readable datagram wakes the end.
                other.asleep = false;
                let datagram = Datagram {
                    bytes: &bytes,
                    fds: &fds,
                    ..Datagram::default()
                };
                other.link.handle(NOW, Input::Datagram(datagram))
            }
            None if is_over => other.link.handle(NOW, Input::Eof),
            None => Ok(()),
        };
        assert_eq!(result, Ok(()), "an honest pair");
        self.drain();
    }

    /// Puts an end to sleep if it has nothing to do.
    fn park(&mut self, end: usize) {
        if end == 0 && !self.reliable {
            return;
        }
        let words = &self.shared.words;
        self.end_ref(end).link.park(words);
        self.sending.harvest(words, &self.shared);
        let idle = self.is_idle(end);
        if !idle {
            self.end_ref(end).link.unpark(&self.shared.words);
        }
        self.end(end).asleep = idle;
    }

    const fn end_ref(&self, end: usize) -> &Driver {
        match end {
            0 => &self.sending.at,
            _ => &self.receiving.at,
        }
    }

    pub(crate) fn is_idle(&self, end: usize) -> bool {
        let words = &self.shared.words;
        match end {
            0 => {
                let is_back = words.back().iter().any(|it| *it != EMPTY);
                !is_back && !self.sending.at.link.has_room(words)
            }
            _ => !self.receiving.at.link.may_take(words),
        }
    }

    /// Kills a process while it sends or takes: its accesses from `at` on have no effect, and its
    /// socket closes.
    fn kill(&mut self, end: usize, at: u32, within: Option<u32>) {
        self.sound = false;
        if self.end_ref(end).ended {
            return;
        }
        let dying = Between::new(&self.shared.words, at, |_| true);
        // A copy of the link does the work, since the state of a killed process is lost.
        let mut link = self.end_ref(end).link.clone();
        if end == 0 {
            self.sending.die(&mut link, &dying, &self.shared, within);
        } else {
            let copy = |_| Some(head(1 << 60).to_bytes());
            let _ = link.take(&LentRing::new(&dying, copy));
            self.receiving.is_dead = true;
        }
        drop(dying);
        let at = self.end(end);
        (at.full, at.kept) = (false, None);
        let _ = at.link.handle(NOW, Input::Eof);
    }
}
