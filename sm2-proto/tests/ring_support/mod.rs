//! Two ends of a link of the ring lane, the words between them, and their drivers.
#![allow(dead_code, reason = "each test binary uses its part")]

pub(crate) mod between;
pub(crate) mod calls;
pub(crate) mod checks;
pub(crate) mod ends;
pub(crate) mod noting;
pub(crate) mod pair;
pub(crate) mod world;

use std::{
    cell::{Cell, RefCell},
    collections::{BTreeMap, VecDeque},
};

use sm2_proto::{
    Datagram, FdFacts, Instant, Machine,
    limits::{CELL_MAX, SLOT_HEAD},
    link::{
        At, Attachment, Body, CELL_WORDS, CellMessage, CellWord, Config, Delivery, EMPTY, Error,
        Fate, FrameKind, Input, LentRing, Link, NoDelivery, OutboundMessage, Output, RingLayout,
        RingMemory, Role, SegmentInfo, SlotHead, SlotRange, Status, Wake, Word, wire::Frame,
    },
};

use crate::link_support::{NOW, pooled, ring_file, with_ring};

/// A segment of 16 slots. The test chooses its number.
pub(crate) const fn segment(id: u32) -> SegmentInfo {
    SegmentInfo {
        id,
        stride: 4096,
        slots: 16,
    }
}

/// The words of a ring, by the offsets of the layout.
#[derive(Clone)]
pub(crate) struct Memory {
    pub(crate) layout: RingLayout,
    words: RefCell<BTreeMap<u64, u64>>,
    /// The number of loads, swaps and takes since the last call of `take_accesses`.
    accesses: Cell<u32>,
}

impl Memory {
    pub(crate) fn new(layout: RingLayout) -> Self {
        Self {
            layout,
            words: RefCell::default(),
            accesses: Cell::new(0),
        }
    }

    pub(crate) fn read(&self, at: At) -> u64 {
        let offset = self.layout.offset(at).expect("a word of the ring");
        self.words.borrow().get(&offset).copied().unwrap_or(EMPTY)
    }

    pub(crate) fn write(&self, at: At, bits: u64) -> u64 {
        let before = self.read(at);
        let offset = self.layout.offset(at).unwrap();
        self.words.borrow_mut().insert(offset, bits);
        before
    }

    /// The offset of a word behind a forward word, in bytes; `number` 0 is the first of them.
    fn cell_offset(&self, index: u32, number: usize) -> u64 {
        assert!(number < CELL_WORDS, "the cell has no word {number}");
        let forward = self.layout.offset(At::Forward(index));
        forward.expect("a cell of the ring") + 8 + 8 * number as u64
    }

    /// Writes words of a cell, from the word `first` on.
    pub(crate) fn write_cell_from(&self, index: u32, first: usize, words: &[u64]) {
        for (number, bits) in (first..).zip(words) {
            let offset = self.cell_offset(index, number);
            self.words.borrow_mut().insert(offset, *bits);
        }
    }

    /// Reads words of a cell, from the word `first` on.
    pub(crate) fn read_cell_from(&self, index: u32, first: usize, words: &mut [u64]) {
        for (number, bits) in (first..).zip(words) {
            let offset = self.cell_offset(index, number);
            *bits = self.words.borrow().get(&offset).copied().unwrap_or(0);
        }
    }

    pub(crate) fn take_accesses(&self) -> u32 {
        self.accesses.take()
    }

    fn count(&self) {
        self.accesses.set(self.accesses.get() + 1);
    }

    /// The words that are not 0, by offset.
    pub(crate) fn image(&self) -> BTreeMap<u64, u64> {
        let words = self.words.borrow();
        let words = words.iter().filter(|(_, bits)| **bits != EMPTY);
        words.map(|(offset, bits)| (*offset, *bits)).collect()
    }

    /// Writes all words: those that `image` does not name are 0.
    pub(crate) fn set_image(&self, image: &BTreeMap<u64, u64>) {
        self.words.replace(image.clone());
    }

    /// The forward words, by index.
    pub(crate) fn forward(&self) -> Vec<u64> {
        let indices = 0..u32::from(self.layout.depth());
        indices.map(|index| self.read(At::Forward(index))).collect()
    }

    /// The back words, by index.
    pub(crate) fn back(&self) -> Vec<u64> {
        let indices = 0..self.layout.window();
        indices.map(|index| self.read(At::Back(index))).collect()
    }
}

impl RingMemory for Memory {
    fn load(&self, at: At) -> u64 {
        self.count();
        self.read(at)
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        self.count();
        self.write(at, bits)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        self.count();
        let was = self.read(at);
        if was == bits {
            self.write(at, EMPTY);
        }
        was == bits
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        self.write_cell_from(index, 0, words);
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        self.read_cell_from(index, 0, words);
    }

    fn fence(&self) {}
}

/// The bits of the word of a message.
pub(crate) fn word(segment: u32, slot: u32, sequence: u64) -> u64 {
    Word::new(segment, slot, sequence).unwrap().to_bits()
}

/// The bits of the word of a message in a cell.
pub(crate) fn cell(len: usize, status: Status, sequence: u64) -> u64 {
    CellWord::new(len, status, sequence).unwrap().to_bits()
}

/// The payload of the message with this id, if it is in a cell. All lengths occur.
pub(crate) fn content(id: u64) -> Vec<u8> {
    let len = (13 * id) % (CELL_MAX as u64 + 1);
    (0..len).map(|at| (7 * id + at + 1) as u8).collect()
}

/// The message with this id, for a cell. Its time is that of its [`head`].
pub(crate) fn cell_message(id: u64, bytes: &[u8]) -> CellMessage<'_> {
    CellMessage {
        id,
        time: head(id).time,
        status: Status::Ok,
        bytes,
    }
}

pub(crate) fn head(id: u64) -> SlotHead {
    SlotHead {
        id,
        time: Instant(100 + id),
        len: id % 7,
        status: Status::Ok,
    }
}

pub(crate) const SENDER: usize = 0;
pub(crate) const RECEIVER: usize = 1;

/// Both ends, with queues as sockets, the ring, and the heads of all slots.
pub(crate) struct Rig {
    pub(crate) ends: [Link; 2],
    /// The datagrams that each end has sent and the other end has not read.
    pub(crate) wires: [VecDeque<(Vec<u8>, Vec<FdFacts>)>; 2],
    /// All outputs except `Transmit` and `Settled`.
    pub(crate) outputs: [Vec<Output>; 2],
    pub(crate) words: Memory,
    pub(crate) heads: BTreeMap<(u32, u32), [u8; SLOT_HEAD]>,
    /// The messages that were settled at the sender, in order.
    pub(crate) settled: Vec<(u64, Fate)>,
    strides: BTreeMap<u32, u64>,
}

pub(crate) fn ring_config(role: Role, reliable: bool, depth: u16, max_borrowed: u16) -> Config {
    Config {
        reliable,
        depth,
        max_borrowed,
        ..with_ring(role)
    }
}

impl Rig {
    /// Both ends, before they have read any frame.
    pub(crate) fn fresh(reliable: bool, depth: u16, max_borrowed: u16) -> Self {
        let config = |role| ring_config(role, reliable, depth, max_borrowed);
        Self::with([Role::Sender, Role::Receiver].map(config))
    }

    /// A sender and a receiver with these configurations, before they have read any frame.
    pub(crate) fn with(configs: [Config; 2]) -> Self {
        let layout = configs[RECEIVER].ring_layout().unwrap();
        let mut rig = Self {
            ends: configs.map(Link::new),
            wires: Default::default(),
            outputs: Default::default(),
            words: Memory::new(layout),
            heads: BTreeMap::new(),
            settled: Vec::new(),
            strides: BTreeMap::new(),
        };
        rig.drain(SENDER);
        rig.drain(RECEIVER);
        rig
    }

    /// Open ends, with a ring, and with segment 0 attached.
    pub(crate) fn open(reliable: bool, depth: u16, max_borrowed: u16) -> Self {
        Self::fresh(reliable, depth, max_borrowed).opened()
    }

    /// The same ends after all frames were read, with segment 0 attached.
    pub(crate) fn opened(mut self) -> Self {
        self.pump();
        self.attach(segment(0));
        self.pump();
        self.words.take_accesses();
        self
    }

    pub(crate) fn attach(&mut self, info: SegmentInfo) {
        self.strides.insert(info.id, info.stride);
        assert_eq!(self.input(SENDER, Input::Attach(info)), Ok(()));
    }

    pub(crate) fn input(&mut self, end: usize, input: Input<'_>) -> Result<(), Error> {
        let result = self.ends[end].handle(NOW, input);
        self.drain(end);
        result
    }

    pub(crate) fn drain(&mut self, end: usize) {
        while let Some(output) = self.ends[end].poll() {
            match output {
                Output::Transmit(packet) => {
                    let bytes = packet.to_vec();
                    let fds = match packet.attachment {
                        None => vec![],
                        Some(Attachment::Ring) => vec![ring_file(self.words.layout.size_bytes())],
                        Some(Attachment::Segment(id)) => vec![pooled(self.size_bytes(id, &bytes))],
                        Some(Attachment::Message(_)) => panic!("no sealed messages here"),
                    };
                    self.wires[end].push_back((bytes, fds));
                }
                Output::Settled { key, fate } => self.settled.push((key, fate)),
                other => self.outputs[end].push(other),
            }
        }
    }

    fn size_bytes(&self, id: u32, attach: &[u8]) -> u64 {
        let slots = u32::from_le_bytes(attach[16..20].try_into().unwrap());
        self.strides[&id] * u64::from(slots)
    }

    /// Lets the other end read one datagram of this end. Returns false if there was none.
    pub(crate) fn carry(&mut self, end: usize) -> bool {
        let Some((bytes, fds)) = self.wires[end].pop_front() else {
            return false;
        };
        let datagram = Datagram {
            bytes: &bytes,
            fds: &fds,
            ..Datagram::default()
        };
        let result = self.input(1 - end, Input::Datagram(datagram));
        let over = self.ends[1 - end].end().is_some();
        assert!(result.is_ok() || over, "{result:?} of {bytes:?}");
        true
    }

    /// Lets both ends read all datagrams.
    pub(crate) fn pump(&mut self) {
        while self.carry(SENDER) || self.carry(RECEIVER) {}
    }

    /// The kinds of the frames in flight.
    pub(crate) fn underway(&self, end: usize) -> Vec<FrameKind> {
        let kind = |it: &(Vec<u8>, _)| FrameKind::from_number(it.0[0]).unwrap();
        self.wires[end].iter().map(kind).collect()
    }

    /// Sends a message in segment 0. Its key is ten times its id.
    pub(crate) fn send(&mut self, id: u64, slot: u32) -> Result<Wake, Error> {
        self.send_in(segment(0), id, slot)
    }

    pub(crate) fn send_in(
        &mut self,
        segment: SegmentInfo,
        id: u64,
        slot: u32,
    ) -> Result<Wake, Error> {
        let head = head(id);
        self.heads.insert((segment.id, slot), head.to_bytes());
        let message = OutboundMessage {
            key: 10 * id,
            id,
            time: Instant(0),
            status: Status::Ok,
            len: head.len,
            body: Body::Pooled { segment, slot },
        };
        let settled = &mut self.settled;
        let sent = self.ends[SENDER].send(&self.words, message.clone(), |key, fate| {
            settled.push((key, fate))
        });
        self.drain(SENDER);
        sent
    }

    /// Sends a message in a cell, with the [`content`] of its id.
    pub(crate) fn send_in_cell(&mut self, id: u64) -> Result<Wake, Error> {
        self.send_bytes(&cell_message(id, &content(id)))
    }

    pub(crate) fn send_bytes(&mut self, message: &CellMessage<'_>) -> Result<Wake, Error> {
        let settled = &mut self.settled;
        let sent = self.ends[SENDER]
            .send_in_cell(&self.words, message, |key, fate| settled.push((key, fate)));
        self.drain(SENDER);
        sent
    }

    /// Writes a cell of a peer, with the word of the message and the first words behind it.
    pub(crate) fn put_cell(&self, index: u32, bits: u64, words: &[u64]) {
        self.words.write_cell_from(index, 0, words);
        self.words.write(At::Forward(index), bits);
    }

    pub(crate) fn harvest(&mut self) -> Result<Wake, Error> {
        let settled = &mut self.settled;
        let harvested =
            self.ends[SENDER].harvest(&self.words, |key, fate| settled.push((key, fate)));
        self.drain(SENDER);
        harvested
    }

    pub(crate) fn settle_returned(&mut self) -> Result<(), Error> {
        let settled = &mut self.settled;
        let result =
            self.ends[SENDER].settle_returned(&self.words, |key, fate| settled.push((key, fate)));
        self.drain(SENDER);
        result
    }

    pub(crate) fn take(&mut self) -> Result<Option<Delivery>, NoDelivery> {
        let heads = &self.heads;
        let taken = self.ends[RECEIVER].take(&LentRing::new(&self.words, |slot: SlotRange| {
            let index = u32::try_from(slot.offset / slot.stride).unwrap();
            let head = heads.get(&(slot.segment, index));
            Some(*head.expect("a slot with a head"))
        }));
        self.drain(RECEIVER);
        taken
    }

    /// Takes the next message, which must be in the ring.
    pub(crate) fn taken(&mut self) -> Delivery {
        self.take().unwrap().expect("a message is there")
    }

    pub(crate) fn release(&mut self, sequence: u64) -> Result<Wake, Error> {
        self.release_all([sequence])
    }

    pub(crate) fn release_all(
        &mut self,
        sequences: impl IntoIterator<Item = u64>,
    ) -> Result<Wake, Error> {
        let released = self.ends[RECEIVER].release_all(&self.words, sequences);
        self.drain(RECEIVER);
        released
    }

    /// Returns the messages settled since the last call.
    pub(crate) fn settled(&mut self) -> Vec<(u64, Fate)> {
        std::mem::take(&mut self.settled)
    }

    pub(crate) fn room(&self) -> bool {
        self.ends[SENDER].has_room(&self.words)
    }

    /// Feeds a frame of a peer, which the end must accept.
    pub(crate) fn frame(&mut self, end: usize, frame: &Frame<'_>, fds: &[FdFacts]) {
        let bytes = frame.to_vec();
        let datagram = Datagram {
            bytes: &bytes,
            fds,
            ..Datagram::default()
        };
        assert_eq!(self.input(end, Input::Datagram(datagram)), Ok(()));
    }
}
