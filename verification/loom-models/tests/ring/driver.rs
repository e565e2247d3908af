//! The steps of the driver of `sm2-node` that use the machine of one end: those of
//! `driver/interface/road.rs`, `driver/link/road.rs` and `driver/link/take.rs`, and those of `driver/wait.rs` for a
//! thread that sleeps at once.

use std::collections::VecDeque;
use std::sync::Arc;

use sm2_proto::link::{
    Attachment, CellMessage, Config, Delivery, End, Error, Fate, Input, LaneKind, LentRing, Link,
    MaxLen, Misuse, NoDelivery, Output, Payload, Publications, RingLayout, RingMemory, RingMessage,
    Role, SlotHead, SlotRange, Status, Wake, doorbell,
};
use sm2_proto::{
    Datagram, Farewell, FdFacts, Instant, LinkId, Machine, Period, Seals, limits::SLOT_HEAD,
};

use crate::memory::Memory;
use crate::socket::{Read, Socket};

const NOW: Instant = Instant(0);

/// A step of a driver that a model can leave out.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    Park,
    LookAgain,
    Ring,
    /// After a reliable receiver has taken a message, checks whether to ring the sender's bell.
    TellOfRoom,
    /// Reads the ring again after the end of the stream.
    TakeTheRest,
}

/// The steps of a driver: all of them, or all but one.
#[derive(Clone, Copy)]
pub(crate) struct Order {
    left_out: Option<Step>,
}

impl Order {
    pub(crate) const fn without(step: Step) -> Self {
        Self {
            left_out: Some(step),
        }
    }

    fn has(self, step: Step) -> bool {
        self.left_out != Some(step)
    }
}

/// The steps of `sm2-node`.
pub(crate) const NODE: Order = Order { left_out: None };

/// Ring words of a process that may be killed.
pub(crate) trait Mortal: RingMemory {
    /// Counts a step. Returns whether the process still executes it.
    fn step(&self) -> bool;
    fn is_dead(&self) -> bool;
}

/// One end of a link.
pub(crate) struct Driver<W> {
    pub(crate) link: Link,
    pub(crate) words: W,
    pub(crate) memory: Arc<Memory>,
    socket: Socket,
    order: Order,
    /// Sender: whether the message with this id travels in a cell.
    pub(crate) in_cell: fn(u64) -> bool,
    /// The ids of all messages that it has sent or taken, in order.
    pub(crate) seen: Vec<u64>,
    /// Sender: the fates of its messages in slots, by id.
    pub(crate) settled: Vec<(u64, Fate)>,
    /// Sender: the message in each slot. A slot whose message was closed by the end of the link is
    /// never written again.
    slots: Vec<Option<u64>>,
    /// Receiver: the messages in slots that the application holds.
    pub(crate) held: Vec<Delivery>,
}

/// The open machines of a sender and a receiver, with a ring and a segment.
pub(crate) fn links(reliable: bool, max_borrowed: u16, memory: &Memory) -> [Link; 2] {
    let config = |role| Config {
        id: LinkId {
            epoch: 1,
            serial: 1,
        },
        version: 1,
        role,
        reliable,
        sealed: false,
        ring: true,
        depth: memory.layout.depth(),
        max_borrowed,
        max_len: MaxLen::DEFAULT,
        deadline: Period::NONE,
        lifespan: Period::NONE,
        lease: Period::NONE,
        publications: Publications::UNKNOWN,
    };
    let mut ends = [Role::Sender, Role::Receiver].map(|role| Link::new(config(role)));
    exchange(&mut ends, memory);
    let attach = Input::Attach(memory.segment());
    ends[0].handle(NOW, attach).expect("a segment");
    exchange(&mut ends, memory);
    assert!(
        ends.iter()
            .all(|it| it.is_open() && it.lane() == LaneKind::Ring)
    );
    ends
}

/// Carries datagrams until none is left.
fn exchange(ends: &mut [Link; 2], memory: &Memory) {
    let file = |size_bytes, seals| FdFacts {
        regular: true,
        size_bytes,
        seals,
    };
    let segment = memory.segment();
    let mut underway = VecDeque::new();
    loop {
        for (from, end) in ends.iter_mut().enumerate() {
            while let Some(output) = end.poll() {
                if let Output::Transmit(packet) = output {
                    underway.push_back((1 - from, packet));
                }
            }
        }
        let Some((to, packet)) = underway.pop_front() else {
            return;
        };
        let facts = match packet.attachment {
            Some(Attachment::Ring) => file(memory.layout.size_bytes(), Seals::RING),
            _ => file(segment.stride * u64::from(segment.slots), Seals::POOLED),
        };
        let datagram = Datagram {
            bytes: &packet.to_vec(),
            fds: &[facts][..usize::from(packet.attachment.is_some())],
            ..Datagram::default()
        };
        let taken = ends[to].handle(NOW, Input::Datagram(datagram));
        taken.expect("what a correct end sends");
    }
}

impl<W: Mortal> Driver<W> {
    pub(crate) fn new(
        link: Link,
        words: W,
        memory: Arc<Memory>,
        socket: Socket,
        (order, in_cell): (Order, fn(u64) -> bool),
    ) -> Self {
        let slots = vec![None; memory.slots.len()];
        Self {
            link,
            words,
            memory,
            socket,
            order,
            in_cell,
            seen: Vec::new(),
            settled: Vec::new(),
            slots,
            held: Vec::new(),
        }
    }

    pub(crate) fn is_over(&self) -> bool {
        self.link.end().is_some() || self.words.is_dead()
    }

    /// The process ends, killed or not.
    pub(crate) fn exit(&self) {
        self.socket.close();
    }

    pub(crate) fn close(&mut self) {
        let closed = self.link.handle(NOW, Input::Close(Farewell::Done.code()));
        assert!(closed.is_ok() || self.is_over());
        self.drain();
    }

    /// Models `SharedNode::wait_as`.
    pub(crate) fn wait<T>(&mut self, mut look: impl FnMut(&mut Self) -> Option<T>) -> Option<T> {
        loop {
            for driven in [false, true] {
                if driven {
                    self.drive();
                }
                let found = look(self);
                if found.is_some() || self.is_over() {
                    return found;
                }
            }
            if self.order.has(Step::Park) {
                self.link.park(&self.words);
                if self.order.has(Step::LookAgain) {
                    let found = look(self);
                    if found.is_some() || self.is_over() {
                        return found;
                    }
                }
            }
            if self.words.step() {
                self.socket.sleep_until_readable();
            }
        }
    }

    /// Reads all available datagrams.
    pub(crate) fn drive(&mut self) {
        while !self.is_over() && self.words.step() {
            let input = match self.socket.receive() {
                Read::Datagram(bytes) => {
                    let datagram = Datagram {
                        bytes: &bytes,
                        ..Datagram::default()
                    };
                    let taken = self.link.handle(NOW, Input::Datagram(datagram));
                    self.drain();
                    assert!(taken.is_ok() || self.is_over(), "{taken:?}");
                    continue;
                }
                Read::Nothing => return,
                Read::Closed => Input::Eof,
            };
            let _ = self.link.handle(NOW, input);
            self.drain();
        }
    }

    fn drain(&mut self) {
        while let Some(output) = self.link.poll() {
            match output {
                Output::Transmit(packet) if self.words.step() => {
                    self.socket.send(&packet.to_vec());
                }
                Output::Transmit(_) => {}
                Output::Settled { key, fate } => {
                    settle(&mut self.slots, &mut self.settled, key, fate)
                }
                // A killed process has read nothing more.
                Output::Ended(End::Violation(rule)) if !self.words.is_dead() => {
                    panic!("the other end broke {}: {}", rule.clause(), rule.kind())
                }
                Output::Ended(_) => {}
                other => panic!("not after a link is open: {other:?}"),
            }
        }
    }

    fn ring_the_bell(&self) {
        if self.order.has(Step::Ring) && self.words.step() {
            self.socket.send(&doorbell());
        }
    }
}

fn settle(slots: &mut [Option<u64>], settled: &mut Vec<(u64, Fate)>, key: u64, fate: Fate) {
    settled.push((key, fate));
    if fate != Fate::Closed {
        let slot = slots.iter_mut().find(|it| **it == Some(key));
        *slot.expect("a message that is settled once") = None;
    }
}

/// The sender.
impl<W: Mortal> Driver<W> {
    pub(crate) fn harvest(&mut self) {
        if self.is_over() {
            return;
        }
        let (slots, settled) = (&mut self.slots, &mut self.settled);
        let harvested = self
            .link
            .harvest(&self.words, |key, fate| settle(slots, settled, key, fate));
        assert!(harvested.is_ok() || self.words.is_dead(), "{harvested:?}");
        self.drain();
    }

    /// Publishes the next message. On a reliable link, waits for room.
    pub(crate) fn publish(&mut self) {
        self.harvest();
        if self.is_over() {
            return;
        }
        let id = self.seen.len() as u64 + 1;
        let slot = (!(self.in_cell)(id)).then(|| self.fill_slot(id));
        let reliable = self.link.config().reliable;
        if !reliable || self.link.has_room(&self.words) {
            return self.send(id, slot);
        }
        let sent = self.wait(|it| {
            it.harvest();
            (it.link.has_room(&it.words)).then(|| it.send(id, slot))
        });
        if let (None, Some(slot)) = (sent, slot) {
            self.slots[slot] = None;
        }
    }

    /// Writes a message into a free slot.
    fn fill_slot(&mut self, id: u64) -> usize {
        let Some(slot) = self.slots.iter().position(Option::is_none) else {
            panic!("a slot more than the window is always free");
        };
        self.slots[slot] = Some(id);
        let head = SlotHead {
            id,
            time: NOW,
            len: 8,
            status: Status::Ok,
        };
        self.memory.slots[slot].write(payload_of(id), head.to_bytes());
        slot
    }

    /// Sends the message in this slot, or in its cell.
    fn send(&mut self, id: u64, slot: Option<usize>) {
        self.seen.push(id);
        let (slots, settled) = (&mut self.slots, &mut self.settled);
        let settled = |key, fate| settle(slots, settled, key, fate);
        let sent = match slot {
            Some(slot) => {
                let message = RingMessage {
                    key: id,
                    id,
                    len: 8,
                    segment: self.memory.segment(),
                    slot: slot as u32,
                };
                (self.link).send_in_slot(&self.words, &message, settled)
            }
            None => {
                let message = CellMessage {
                    id,
                    time: Instant(id),
                    status: Status::Ok,
                    bytes: &payload_of(id).to_le_bytes(),
                };
                (self.link).send_in_cell(&self.words, &message, settled)
            }
        };
        match sent {
            Ok(Wake::Needed) => self.ring_the_bell(),
            Ok(Wake::NotNeeded) => {}
            Err(_) if self.words.is_dead() => {}
            Err(Error::Misuse(misuse)) => panic!("{misuse}"),
            Err(Error::Ended(end)) => panic!("{end}"),
        }
    }

    /// Waits until no message is in flight, or the link has ended.
    pub(crate) fn flush(&mut self) {
        self.wait(|it| {
            it.harvest();
            (it.link.in_flight() == 0).then_some(())
        });
    }

    /// Returns the messages in slots with this fate.
    pub(crate) fn settled_as(&self, fate: Fate) -> Vec<u64> {
        let these = self.settled.iter().filter(|it| it.1 == fate);
        these.map(|it| it.0).collect()
    }

    pub(crate) fn free_slots(&self) -> usize {
        self.slots.iter().filter(|it| it.is_none()).count()
    }
}

const fn payload_of(id: u64) -> u64 {
    1000 + id
}

/// The receiver.
impl<W: Mortal> Driver<W> {
    /// Takes the next message, if there is one, and holds it. Returns its id.
    pub(crate) fn take(&mut self) -> Option<u64> {
        let taken = self.take_word();
        if taken.is_some() {
            self.tell_of_room();
        }
        taken
    }

    /// Takes all messages in the ring in one batch, and holds them.
    pub(crate) fn take_all(&mut self) {
        while self.take_word().is_some() {}
        self.tell_of_room();
    }

    fn tell_of_room(&mut self) {
        if self.order.has(Step::TellOfRoom) && self.link.made_room(&self.words).is_needed() {
            self.ring_the_bell();
        }
    }

    fn take_word(&mut self) -> Option<u64> {
        if self.is_over() && !self.order.has(Step::TakeTheRest) {
            return None;
        }
        let slots = &self.memory.slots;
        let head = |slot: SlotRange| -> Option<[u8; SLOT_HEAD]> {
            slots.get((slot.offset / slot.stride) as usize)?.head()
        };
        let taken = self.link.take(&LentRing::new(&self.words, head));
        if self.words.is_dead() {
            return None;
        }
        let delivery = match taken {
            Ok(Some(delivery)) => delivery,
            Ok(None) | Err(NoDelivery::TooManyBorrowed(_)) => return None,
            Err(error) => panic!("the other end broke the rules: {error}"),
        };
        let last = self.seen.last().copied().unwrap_or_default();
        assert!(delivery.id > last, "{} after {last}", delivery.id);
        assert_eq!(
            delivery.lost,
            delivery.id - last - 1,
            "what is said to be lost"
        );
        let id = delivery.id;
        self.seen.push(id);
        match &delivery.payload {
            Payload::Cell(bytes) => {
                let right = payload_of(id).to_le_bytes();
                let is_whole = delivery.time == Instant(id) && bytes[..] == right;
                assert!(is_whole, "message {id} is torn: {delivery:?}");
            }
            _ => self.held.push(delivery),
        }
        Some(id)
    }

    /// Waits for the next message. Returns `None` if the link has ended and no message is left.
    pub(crate) fn receive(&mut self) -> Option<u64> {
        let found = self.wait(Self::take);
        if found.is_some() || self.words.is_dead() {
            return found;
        }
        // Takes a message that was sent after the previous look and before the end of the link.
        self.take()
    }

    /// Reads the oldest held message, and releases it.
    pub(crate) fn release(&mut self) {
        if !self.held.is_empty() {
            self.release_oldest(1);
        }
    }

    /// Reads all held messages, and releases them in one batch.
    pub(crate) fn release_all(&mut self) {
        self.release_oldest(self.held.len());
    }

    fn release_oldest(&mut self, count: usize) {
        if self.words.is_dead() {
            return;
        }
        let deliveries: Vec<Delivery> = self.held.drain(..count).collect();
        for delivery in &deliveries {
            let Payload::Pooled { offset, .. } = delivery.payload else {
                panic!("on the ring lane all others are pooled");
            };
            let slot = &self.memory.slots[(offset / self.memory.segment().stride) as usize];
            assert_eq!(slot.payload(), payload_of(delivery.id), "another payload");
        }
        let sequences = deliveries.iter().map(|it| it.sequence);
        match self.link.release_all(&self.words, sequences) {
            Ok(Wake::Needed) => self.ring_the_bell(),
            Ok(Wake::NotNeeded) | Err(Error::Ended(_)) => {}
            Err(Error::Misuse(misuse)) => {
                assert_ne!(misuse, Misuse::NotBorrowed);
                panic!("{misuse}");
            }
        }
        assert!(
            self.words.is_dead() || !matches!(self.link.end(), Some(End::Violation(_))),
            "the back word was not empty"
        );
    }
}

/// A ring of this depth, for an application that holds up to `max_borrowed` messages.
pub(crate) fn layout(depth: u16, max_borrowed: u16) -> RingLayout {
    RingLayout::new(depth, u32::from(depth + max_borrowed)).expect("a small ring")
}
