//! The two ends of a pair of the ring lane: their applications, drivers and lists.
//!
//! The lists restate the rules of SPEC: the messages sent, the messages taken, and the fate of
//! each.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet, VecDeque},
};

use sm2_proto::{
    FdFacts, Instant, Machine,
    limits::SLOT_HEAD,
    link::{
        Attachment, Body, Delivery, Error, Fate, Input, LaneKind, LentRing, Link, Misuse,
        NoDelivery, OutboundMessage, Output, Packet, Payload, RingMemory, SegmentInfo, SlotRange,
        Status, Wake, doorbell,
    },
};

use crate::{
    link_support::{NOW, pooled, ring_file},
    ring_support::between::Between,
    ring_support::{Memory, cell, cell_message, content, head, word},
};

/// More slots per segment than messages in a window.
const SLOTS: u32 = 8;

const fn segment(id: u32) -> SegmentInfo {
    SegmentInfo {
        id,
        stride: 4096,
        slots: SLOTS,
    }
}

/// The memory that both ends map: the ring, and the heads of all slots.
pub(crate) struct Shared {
    pub(crate) words: Memory,
    pub(crate) heads: RefCell<BTreeMap<(u32, u32), [u8; SLOT_HEAD]>>,
}

/// One end, and its socket.
pub(crate) struct Driver {
    pub(crate) link: Link,
    /// The datagrams that this end has sent and the other end has not read.
    pub(crate) wire: VecDeque<(Vec<u8>, Vec<FdFacts>)>,
    pub(crate) kept: Option<Packet>,
    pub(crate) full: bool,
    pub(crate) ended: bool,
    /// True if the end waits for the doorbell.
    pub(crate) asleep: bool,
    /// Segments that the other end has attached here.
    pub(crate) mapped: BTreeSet<u32>,
}

impl Driver {
    pub(crate) fn new(link: Link) -> Self {
        Self {
            link,
            wire: VecDeque::new(),
            kept: None,
            full: false,
            ended: false,
            asleep: false,
            mapped: BTreeSet::new(),
        }
    }

    /// Carries out the outputs of the link. Returns the settled messages.
    pub(crate) fn drain(&mut self, size_bytes: u64) -> Vec<(u64, Fate)> {
        let mut settled = Vec::new();
        while let Some(output) = self.link.poll() {
            assert!(!self.ended, "nothing comes after Ended: {output:?}");
            match output {
                Output::Transmit(packet) if self.full => {
                    assert!(self.kept.replace(packet).is_none());
                    let _ = self.link.handle(NOW, Input::Blocked);
                }
                Output::Transmit(packet) => {
                    assert!(self.kept.is_none(), "nothing overtakes what is kept");
                    self.put(&packet, size_bytes);
                }
                Output::Settled { key, fate } => settled.push((key, fate)),
                Output::Attach { segment, .. } => assert!(self.mapped.insert(segment)),
                Output::Detach { segment } => assert!(self.mapped.remove(&segment)),
                Output::Opened | Output::Ring(_) => {}
                Output::Ended(_) => (self.ended, self.kept) = (true, None),
                other => panic!("not on the ring lane: {other:?}"),
            }
        }
        settled
    }

    pub(crate) fn put(&mut self, packet: &Packet, size_bytes: u64) {
        let fds = match packet.attachment {
            None => vec![],
            Some(Attachment::Ring) => vec![ring_file(size_bytes)],
            Some(Attachment::Segment(_)) => vec![pooled(4096 * u64::from(SLOTS))],
            Some(Attachment::Message(_)) => panic!("no sealed messages here"),
        };
        self.wire.push_back((packet.to_vec(), fds));
    }

    /// Sends a doorbell. If the socket is full, it is dropped: the other end has a datagram to read
    /// anyway.
    pub(crate) fn ring_the_bell(&mut self) {
        if !self.full || self.wire.is_empty() {
            self.wire.push_back((doorbell().to_vec(), vec![]));
        }
    }
}

/// A message in the sender's list.
pub(crate) struct Sent {
    pub(crate) id: u64,
    pub(crate) sequence: u64,
    /// The segment and the slot; `None` if it is in a cell.
    pub(crate) place: Option<(u32, u32)>,
    /// The fate of a message in a cell is never passed to the application, so the list has it only
    /// once it can be told from the ring: see `Pair::settle_cells`.
    pub(crate) fate: Option<Fate>,
}

impl Sent {
    /// True if the message has this slot, which must not be written.
    fn keeps(&self, place: (u32, u32)) -> bool {
        self.place == Some(place) && matches!(self.fate, None | Some(Fate::Closed))
    }
}

/// The sending application, its driver, and its list.
pub(crate) struct Sending {
    pub(crate) at: Driver,
    pub(crate) sent: Vec<Sent>,
    pub(crate) next_id: u64,
    pub(crate) skipped: u64,
    pub(crate) overwritten: u64,
}

/// The receiving application, its driver, and its list.
pub(crate) struct Receiving {
    pub(crate) at: Driver,
    pub(crate) held: Vec<Delivery>,
    /// The sequence number and id of every message taken.
    pub(crate) taken: Vec<(u64, u64)>,
    /// How many messages had been taken when the link ended.
    pub(crate) taken_before_end: Option<usize>,
    /// True if the receiver was killed, so that nobody takes the remaining messages.
    pub(crate) is_dead: bool,
}

impl Sending {
    pub(crate) fn settle(&mut self, shared: &Shared, key: u64, fate: Fate) {
        let sent = self.sent.iter_mut().find(|it| it.id == key).unwrap();
        assert_eq!(sent.fate.replace(fate), None, "settled once");
        if fate != Fate::Closed {
            // An end that wrongly still reads this slot sees garbage.
            let garbage = [0xaa; SLOT_HEAD];
            let place = sent.place.expect("only messages in slots are settled");
            shared.heads.borrow_mut().insert(place, garbage);
        }
    }

    pub(crate) fn drain(&mut self, shared: &Shared) {
        for (key, fate) in self.at.drain(shared.words.layout.size_bytes()) {
            self.settle(shared, key, fate);
        }
    }

    /// A free slot of the segment. Slots of settled messages are reused, the last one first. A slot
    /// whose message was closed by the end of the link is never reused.
    fn free_slot(&self, within: u32) -> Option<(u32, u32)> {
        let places = (0..SLOTS).map(|slot| (within, slot));
        let is_free = |place: &(u32, u32)| !self.sent.iter().any(|it| it.keeps(*place));
        let last = |place: &(u32, u32)| self.sent.iter().rposition(|it| it.place == Some(*place));
        places.filter(is_free).max_by_key(last)
    }

    /// Sends one message, if the link accepts it: in a slot of this segment, or else in a cell.
    pub(crate) fn send(&mut self, words: &impl RingMemory, shared: &Shared, within: Option<u32>) {
        if self.at.ended || !self.at.link.is_open() {
            return;
        }
        self.next_id += 1;
        let id = self.next_id;
        let place = within.map(|it| self.free_slot(it).expect("more slots than the window"));
        for attached in [false, true] {
            match self.try_send(words, shared, id, place) {
                Err(Error::Misuse(Misuse::NotAttached)) if !attached && place.is_some() => {
                    let attach = Input::Attach(segment(within.unwrap()));
                    let _ = self.at.link.handle(NOW, attach);
                    self.drain(shared);
                }
                Ok(wake) => {
                    if wake.is_needed() {
                        self.at.ring_the_bell();
                    }
                    return;
                }
                Err(Error::Misuse(misuse)) => {
                    let reliable = self.at.link.config().reliable;
                    let expected = match misuse {
                        Misuse::NoRoom => reliable || self.at.full,
                        Misuse::NotAttached => place.is_some(),
                        _ => false,
                    };
                    assert!(expected, "{misuse}");
                    if reliable && misuse == Misuse::NoRoom {
                        self.at.link.handle(NOW, Input::Drop(Fate::NoRoom)).unwrap();
                        self.skipped += 1;
                    } else {
                        self.at
                            .link
                            .handle(NOW, Input::Drop(Fate::Overwritten))
                            .unwrap();
                        self.overwritten += 1;
                    }
                    return;
                }
                Err(Error::Ended(end)) => panic!("{end}"),
            }
        }
    }

    pub(crate) fn try_send(
        &mut self,
        words: &impl RingMemory,
        shared: &Shared,
        id: u64,
        place: Option<(u32, u32)>,
    ) -> Result<Wake, Error> {
        let mut settled = Vec::new();
        let each = |key, fate| settled.push((key, fate));
        let link = &mut self.at.link;
        let result = match place {
            Some(place) => link.send(words, shared.in_slot(id, place), each),
            None => link.send_in_cell(words, &cell_message(id, &content(id)), each),
        };
        for (key, fate) in settled {
            self.settle(shared, key, fate);
        }
        if result.is_ok() {
            let sequence = self.sent.len() as u64 + 1;
            self.sent.push(Sent {
                id,
                sequence,
                place,
                fate: None,
            });
        }
        result
    }

    /// Sends a message and is killed before `send` returns. Words written before that stay in the
    /// ring.
    pub(crate) fn die(
        &mut self,
        link: &mut Link,
        dying: &Between<'_>,
        shared: &Shared,
        within: Option<u32>,
    ) {
        let sequence = self.sent.len() as u64 + 1;
        let id = self.next_id + 1;
        let place = within.map(|it| self.free_slot(it).expect("more slots than the window"));
        let word = match place {
            Some((segment, slot)) => {
                let message = shared.in_slot(id, (segment, slot));
                let _ = link.send(dying, message, |_, _| {});
                word(segment, slot, sequence)
            }
            None => {
                let bytes = content(id);
                let _ = link.send_in_cell(dying, &cell_message(id, &bytes), |_, _| {});
                cell(bytes.len(), Status::Ok, sequence)
            }
        };
        if shared.words.forward().contains(&word) {
            let fate = Some(Fate::Closed);
            self.sent.push(Sent {
                id,
                sequence,
                place,
                fate,
            });
        }
    }

    pub(crate) fn harvest(&mut self, words: &impl RingMemory, shared: &Shared) {
        if self.at.ended || !self.at.link.is_open() {
            return;
        }
        let mut settled = Vec::new();
        let result = (self.at.link).harvest(words, |key, fate| settled.push((key, fate)));
        assert_eq!(result, Ok(Wake::NotNeeded), "nothing waits on a topic");
        for (key, fate) in settled {
            assert_eq!(fate, Fate::Delivered);
            self.settle(shared, key, fate);
        }
    }
}

impl Receiving {
    /// Takes a message. Returns true if it is in a segment whose ATTACH was not read yet.
    pub(crate) fn take(&mut self, words: &impl RingMemory, shared: &Shared) -> bool {
        if self.is_dead {
            return false;
        }
        let limit = usize::from(self.at.link.config().max_borrowed);
        let copy = |slot: SlotRange| {
            let index = u32::try_from(slot.offset / slot.stride).unwrap();
            let heads = shared.heads.borrow();
            heads.get(&(slot.segment, index)).copied()
        };
        match self.at.link.take(&LentRing::new(words, copy)) {
            Ok(Some(delivery)) => {
                let before = self.taken.last().copied();
                let lost = before.map_or(delivery.sequence - 1, |(_, id)| delivery.id - id - 1);
                assert_eq!(delivery.lost, lost);
                assert!(before.is_none_or(|(sequence, _)| delivery.sequence > sequence));
                self.taken.push((delivery.sequence, delivery.id));
                shared.check_content(&delivery);
                if !matches!(delivery.payload, Payload::Cell(_)) {
                    assert!(self.held.len() < limit);
                    self.held.push(delivery);
                }
                if self.at.link.made_room(words).is_needed() {
                    self.at.ring_the_bell();
                }
            }
            Ok(None) => {}
            Err(NoDelivery::TooManyBorrowed(_)) => assert_eq!(self.held.len(), limit),
            Err(NoDelivery::UnknownSegment) => return true,
            Err(NoDelivery::Misuse(_)) => assert_ne!(self.at.link.lane(), LaneKind::Ring),
            Err(other) => panic!("{other}"),
        }
        false
    }

    pub(crate) fn release(&mut self, words: &impl RingMemory, shared: &Shared, pick: usize) {
        if self.held.is_empty() || self.is_dead {
            return;
        }
        let index = pick % self.held.len();
        shared.check_content(&self.held[index]);
        let delivery = self.held.swap_remove(index);
        match self.at.link.release(words, delivery.sequence) {
            Ok(Wake::Needed) => self.at.ring_the_bell(),
            Ok(Wake::NotNeeded) => {}
            Err(error) => assert!(self.at.ended, "{error}"),
        }
    }
}

impl Shared {
    /// The message with this id, whose head is written into this slot.
    fn in_slot(&self, id: u64, place: (u32, u32)) -> OutboundMessage {
        let head = head(id);
        self.heads.borrow_mut().insert(place, head.to_bytes());
        OutboundMessage {
            key: id,
            id,
            time: Instant(0),
            status: Status::Ok,
            len: head.len,
            body: Body::Pooled {
                segment: segment(place.0),
                slot: place.1,
            },
        }
    }

    /// Checks that the slot of a held message was not overwritten, or that a message in a cell is
    /// the one that was sent.
    pub(crate) fn check_content(&self, delivery: &Delivery) {
        match &delivery.payload {
            Payload::Pooled { segment, offset } => {
                let place = (*segment, (offset / 4096) as u32);
                let now = self.heads.borrow()[&place];
                assert_eq!(now, head(delivery.id).to_bytes(), "{delivery:?}");
            }
            Payload::Cell(bytes) => {
                assert_eq!(**bytes, content(delivery.id), "{delivery:?}");
                assert_eq!(delivery.len, bytes.len() as u64);
                assert_eq!(delivery.time, head(delivery.id).time);
                assert_eq!(delivery.status, Status::Ok);
            }
            other => panic!("not on the ring lane: {other:?}"),
        }
    }
}
