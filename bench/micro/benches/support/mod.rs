//! The operations that are measured, for wall time and for instructions alike.

#[path = "../../../../sm2-proto/tests/support/bench.rs"]
pub(crate) mod bench;
#[path = "../../../../sm2-proto/tests/support/contracts.rs"]
pub(crate) mod contracts;

use std::sync::atomic::{AtomicU64, Ordering, fence};

use sm2_proto::{
    Datagram, FdFacts, Instant, InterfaceId, LinkId, LinkKey, Machine, NodeId,
    control::{LinkPeer, ToManager, ToNode, encode_to_manager, encode_to_node},
    limits::SLOT_HEAD,
    link::{
        At, Body, CellMessage, Delivery, LentRing, Link, OutboundMessage, RingLayout, RingMemory,
        SegmentInfo, SlotRange, Status, Wake,
        wire::{Carrier, Form, Frame, MessageFrame},
    },
    manager::{Input, Output},
};

use self::{
    bench::{Bench, UNLIMITED},
    contracts::{data, name, publisher, subscriber},
};
use crate::{
    link_support::from_peer,
    ring_support::{RECEIVER, Rig, SENDER, head},
};

/// The words of a ring, flat and atomic as in a driver, in memory of one process.
struct FlatWords {
    layout: RingLayout,
    words: Vec<AtomicU64>,
}

impl FlatWords {
    fn new(layout: RingLayout) -> Self {
        let count = layout.size_bytes() / 8;
        let words = (0..count).map(|_| AtomicU64::new(0)).collect();
        Self { layout, words }
    }

    fn word(&self, at: At) -> &AtomicU64 {
        let offset = self.layout.offset(at).expect("a word of the layout");
        &self.words[(offset / 8) as usize]
    }

    fn cell(&self, index: u32, words: usize) -> &[AtomicU64] {
        let offset = self.layout.offset(At::Forward(index));
        let first = (offset.expect("a cell of the layout") / 8) as usize + 1;
        &self.words[first..first + words]
    }
}

impl RingMemory for FlatWords {
    fn load(&self, at: At) -> u64 {
        self.word(at).load(Ordering::Acquire)
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        self.word(at).swap(bits, Ordering::AcqRel)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        let word = self.word(at);
        word.compare_exchange(bits, 0, Ordering::AcqRel, Ordering::Relaxed)
            .is_ok()
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        for (place, word) in self.cell(index, words.len()).iter().zip(words) {
            place.store(*word, Ordering::Relaxed);
        }
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        let len = words.len();
        for (word, place) in words.iter_mut().zip(self.cell(index, len)) {
            *word = place.load(Ordering::Relaxed);
        }
    }

    fn fence(&self) {
        fence(Ordering::SeqCst);
    }
}

/// Both ends of an open link on the ring lane, and their memory. No side sleeps.
pub(crate) struct RingPair {
    sender: Link,
    receiver: Link,
    words: FlatWords,
    heads: Vec<[u8; SLOT_HEAD]>,
    last_id: u64,
    /// The sequence number of the oldest message that is not given back.
    oldest: u64,
}

impl RingPair {
    /// The number of messages that have room, and that may be held.
    pub(crate) const DEPTH: u16 = 64;
    const SEGMENT: SegmentInfo = SegmentInfo {
        id: 1,
        stride: 4096,
        slots: 4 * Self::DEPTH as u32,
    };

    /// A pair that has gone once around its slots, so that no first-time cost is measured.
    pub(crate) fn steady() -> Box<Self> {
        let mut rig = Rig::open(false, Self::DEPTH, Self::DEPTH);
        rig.attach(Self::SEGMENT);
        rig.pump();
        let ends = &rig.ends;
        let mut pair = Box::new(Self {
            sender: ends[SENDER].clone(),
            receiver: ends[RECEIVER].clone(),
            words: FlatWords::new(rig.words.layout),
            heads: vec![[0; SLOT_HEAD]; Self::SEGMENT.slots as usize],
            last_id: 0,
            oldest: 1,
        });
        for _ in 0..Self::SEGMENT.slots {
            pair.send();
            pair.take();
            pair.give_back();
            pair.harvest();
        }
        pair
    }

    /// Sends, takes and gives back as many messages as there is room for. None is harvested.
    pub(crate) fn carry_turn(&mut self) {
        for _ in 0..Self::DEPTH {
            self.send();
            self.take();
            self.give_back();
        }
    }

    /// Writes the head of a message and sends it. As long as messages are harvested before the
    /// window is full, none is settled by this.
    pub(crate) fn send(&mut self) {
        self.last_id += 1;
        let slot = (self.last_id % u64::from(Self::SEGMENT.slots)) as u32;
        let head = head(self.last_id);
        self.heads[slot as usize] = head.to_bytes();
        let message = OutboundMessage {
            key: self.last_id,
            id: self.last_id,
            time: Instant(0),
            status: Status::Ok,
            len: head.len,
            body: Body::Pooled {
                segment: Self::SEGMENT,
                slot,
            },
        };
        let bell = self.sender.send(&self.words, message.clone(), |_, fate| {
            panic!("{fate:?}, although there is room");
        });
        assert_eq!(
            bell,
            Ok(Wake::NotNeeded),
            "there is room, and nobody sleeps"
        );
    }

    /// Sends a message of 64 bytes in its cell. The receiver has taken the message one round before.
    pub(crate) fn send_in_cell(&mut self) {
        self.last_id += 1;
        let message = CellMessage {
            id: self.last_id,
            time: Instant(0),
            status: Status::Ok,
            bytes: &[7; 64],
        };
        let bell = (self.sender).send_in_cell(&self.words, &message, |_, fate| {
            panic!("{fate:?}, although there is room");
        });
        assert_eq!(
            bell,
            Ok(Wake::NotNeeded),
            "there is room, and nobody sleeps"
        );
    }

    /// Takes the next message, which is there.
    pub(crate) fn take(&mut self) -> Delivery {
        let heads = &self.heads;
        let taken = self
            .receiver
            .take(&LentRing::new(&self.words, |slot: SlotRange| {
                Some(heads[(slot.offset / slot.stride) as usize])
            }));
        taken.expect("the sender keeps to SPEC").expect("a message")
    }

    /// Gives back the oldest message that is held.
    pub(crate) fn give_back(&mut self) {
        let bell = self.receiver.release(&self.words, self.oldest);
        assert_eq!(bell, Ok(Wake::NotNeeded), "it is held, and nobody sleeps");
        self.oldest += 1;
    }

    /// Settles all messages that were given back, and returns their number.
    pub(crate) fn harvest(&mut self) -> usize {
        let mut count = 0;
        let harvested = self.sender.harvest(&self.words, |_, _| count += 1);
        let _ = harvested.expect("the receiver keeps to SPEC");
        count
    }
}

/// DATA with a payload of 64 bytes in the datagram.
pub(crate) fn data_inline() -> Vec<u8> {
    data_frame(Form::Inline, &[7; 64])
}

/// DATA with a payload of 64 bytes in a slot.
pub(crate) fn data_pooled() -> Vec<u8> {
    data_frame(
        Form::Pooled {
            segment: 5,
            slot: 1,
        },
        &[],
    )
}

fn data_frame(form: Form, rest: &[u8]) -> Vec<u8> {
    let frame = MessageFrame {
        form,
        len: 64,
        rest,
        ..from_peer(Carrier::Data, 1, 1)
    };
    Frame::Message(frame).to_vec()
}

const TOPIC: &str = "robot/front/scan";

/// DECLARE of a publisher.
pub(crate) fn declare() -> Vec<u8> {
    encode_to_manager(&ToManager::Declare {
        interface: InterfaceId(1),
        contract: publisher(TOPIC, &data("Scan")),
    })
}

/// LINK to a subscriber. Takes a descriptor along: see [`with_fd`].
pub(crate) fn link() -> Vec<u8> {
    encode_to_node(&ToNode::Link {
        interface: InterfaceId(1),
        link: LinkId {
            epoch: bench::EPOCH,
            serial: 1,
        },
        key: LinkKey(bench::FIRST_KEY),
        version: 1,
        reliable: false,
        sealed: false,
        peer: LinkPeer {
            node: NodeId(2),
            name: name("planner"),
            interface: InterfaceId(1),
            contract: subscriber(TOPIC, Some(&data("Scan"))),
        },
    })
}

/// A datagram with one descriptor, the end of a socket.
pub(crate) fn with_fd(bytes: &[u8]) -> Datagram<'_> {
    const SOCKET: FdFacts = FdFacts {
        regular: false,
        size_bytes: 0,
        seals: sm2_proto::Seals(0),
    };
    Datagram {
        fds: &[SOCKET],
        ..Datagram::new(bytes)
    }
}

/// A name of usual length, and the longest there can be.
pub(crate) const NAMES: [&str; 2] = [TOPIC, LONGEST];
const LONGEST: &str = match str::from_utf8(&[b'a'; sm2_proto::limits::NAME_MAX]) {
    Ok(text) => text,
    Err(_) => panic!("a is a letter"),
};

/// A domain of subscribers on one topic, each with a node of its own, and a node that is about to
/// declare their publisher.
#[derive(Clone)]
pub(crate) struct Audience {
    bench: Bench,
    talker: NodeId,
    declare: Vec<u8>,
    subscribers: usize,
}

impl Audience {
    pub(crate) fn new(subscribers: usize) -> Box<Self> {
        let mut bench = Bench::new(UNLIMITED);
        let contract = subscriber(TOPIC, Some(&data("Scan")));
        for number in 0..subscribers {
            let node = bench.node(1000, &format!("listener-{number}"));
            bench.declared(node, 1, &contract);
        }
        let talker = bench.node(1000, "talker");
        Box::new(Self {
            bench,
            talker,
            declare: declare(),
            subscribers,
        })
    }

    /// Declares the publisher, which is matched and linked, and encodes all frames.
    pub(crate) fn declare_publisher(&mut self) {
        let Bench { manager, now, .. } = &mut self.bench;
        let input = Input::Datagram {
            session: self.talker,
            datagram: Datagram::new(&self.declare),
        };
        manager.handle(*now, input).expect("the session is known");
        let outputs = std::iter::from_fn(|| manager.poll());
        let links = outputs.filter(|it| matches!(it, Output::Link { .. }));
        assert_eq!(links.count(), self.subscribers, "a link to each");
    }
}
