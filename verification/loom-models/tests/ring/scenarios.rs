//! A sender and a receiver of the ring lane, each in its own thread.

use std::cell::{Cell, RefCell};
use std::sync::Arc;

use loom::thread;
use sm2_proto::link::{At, CellWord, Fate, RingMemory as _};

use crate::driver::{Driver, Mortal, NODE, Order, layout, links};
use crate::memory::Memory;
use crate::socket::Socket;
use crate::sync::Ordering;

use super::atomic;

/// One end's words, like [`sm2_io::Ring`], and the messages that this end has put and displaced.
pub(crate) struct ModelRing {
    memory: Arc<Memory>,
    fences: bool,
    /// The number of steps until the process is killed.
    steps: Cell<u32>,
    dead: Cell<bool>,
    put: RefCell<Vec<u64>>,
    displaced: RefCell<Vec<u64>>,
    /// The id of the message that this end last wrote into each cell; `None` if it displaced that message.
    written: RefCell<Vec<Option<u64>>>,
    /// 0 for the sender, 1 for the receiver.
    end: usize,
    /// Whether messages may travel in cells.
    has_cells: bool,
    fault: Fault,
    /// Of a [`Fault`]: the word that was read or taken out early.
    early: Cell<u64>,
}

/// A fault of a machine, which the words of its end make.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    None,
    /// The receiver copies a cell after it has taken the word.
    LateCopy,
    /// The sender writes a cell whose word it has not swapped out.
    EarlyWrite,
}

impl sm2_proto::link::RingMemory for ModelRing {
    fn load(&self, at: At) -> u64 {
        if !self.step() {
            return 0;
        }
        self.note(at, self.end);
        let bits = atomic::load(self.memory.word(at));
        if self.fault == Fault::LateCopy {
            self.early.set(bits);
        }
        bits
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        if !self.step() {
            return 0;
        }
        if let (Fault::EarlyWrite, At::Forward(index), 0) = (self.fault, at, bits) {
            let was = atomic::load(self.memory.word(at));
            self.early.set(was);
            self.written.borrow_mut()[index as usize] = None;
            return was;
        }
        self.note(at, 1 - self.end);
        let was = atomic::swap(self.memory.word(at), bits);
        if let At::Forward(index) = at {
            if was != 0 {
                self.written.borrow_mut()[index as usize] = None;
            }
            self.put
                .borrow_mut()
                .extend((bits != 0).then_some(bits >> 32));
            (self.displaced.borrow_mut()).extend((was != 0).then_some(was >> 32));
        }
        match self.fault {
            // The machine knows the word that it read early.
            Fault::EarlyWrite if self.early.take() != 0 => 0,
            _ => was,
        }
    }

    fn take(&self, at: At, bits: u64) -> bool {
        if self.fault == Fault::LateCopy && CellWord::from_bits(bits).is_some() {
            return self.early.take() == bits;
        }
        if !self.step() {
            return false;
        }
        self.note(at, 1 - self.end);
        atomic::take(self.memory.word(at), bits)
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        if !self.step() {
            return;
        }
        let cell = &self.memory.cells[index as usize];
        if let Some(id) = self.written.borrow_mut()[index as usize].replace(words[0]) {
            let copied = cell.copied.load(Ordering::Relaxed);
            assert_eq!(copied, id, "the receiver may still copy it");
        }
        atomic::write(&cell.words, words);
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        if !self.step() {
            return;
        }
        if self.fault == Fault::LateCopy {
            let word = self.memory.word(At::Forward(index));
            self.note(At::Forward(index), 1 - self.end);
            let bits = self.early.get();
            self.early
                .set(bits * u64::from(atomic::take(word, bits)));
        }
        let cell = &self.memory.cells[index as usize];
        atomic::read(&cell.words, words);
        cell.copied.store(words[0], Ordering::Relaxed);
    }

    fn fence(&self) {
        if self.fences {
            atomic::order();
        }
    }
}

impl ModelRing {
    /// Shows loom an access to a forward word, where messages travel in cells: see `CellPlace::loads`.
    fn note(&self, at: At, loads: usize) {
        if let (At::Forward(index), true) = (at, self.has_cells) {
            let cell = &self.memory.cells[index as usize];
            cell.loads[loads].fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Mortal for ModelRing {
    fn step(&self) -> bool {
        match self.steps.get().checked_sub(1) {
            Some(left) => self.steps.set(left),
            None => self.dead.set(true),
        }
        !self.dead.get()
    }

    fn is_dead(&self) -> bool {
        self.dead.get()
    }
}

/// The settings of a scenario.
#[derive(Clone, Copy)]
pub(crate) struct Terms {
    pub(crate) reliable: bool,
    pub(crate) depth: u16,
    pub(crate) max_borrowed: u16,
    /// The steps of the sender's driver and of the receiver's.
    pub(crate) order: [Order; 2],
    /// True if the sender's fences are executed, and the receiver's.
    pub(crate) fences: [bool; 2],
    /// The number of steps after which the sender and the receiver are killed.
    pub(crate) steps: [u32; 2],
    /// Whether the message with this id travels in a cell.
    pub(crate) in_cell: fn(u64) -> bool,
    pub(crate) fault: Fault,
}

/// A keep-last link with the smallest window.
pub(crate) const LAST: Terms = Terms {
    reliable: false,
    depth: 1,
    max_borrowed: 1,
    order: [NODE; 2],
    fences: [true; 2],
    steps: [u32::MAX; 2],
    in_cell: |_| false,
    fault: Fault::None,
};

pub(crate) const ALL: Terms = Terms {
    reliable: true,
    ..LAST
};

/// Two forward words.
pub(crate) const TWO: Terms = Terms { depth: 2, ..LAST };

type End = Driver<ModelRing>;

/// Sets both ends up in one thread. These steps do not count.
fn pair(terms: Terms) -> (End, End) {
    let layout = layout(terms.depth, terms.max_borrowed);
    // One more slot, for a message that is about to be sent while the window is full.
    let memory = Arc::new(Memory::new(layout, layout.window() + 1));
    let [sender, receiver] = links(terms.reliable, terms.max_borrowed, &memory);
    let (one, other) = Socket::pair();
    let end = |link, socket, index: usize| {
        let words = ModelRing {
            memory: Arc::clone(&memory),
            fences: terms.fences[index],
            steps: Cell::new(u32::MAX),
            dead: Cell::new(false),
            put: RefCell::default(),
            displaced: RefCell::default(),
            written: RefCell::new(vec![None; usize::from(terms.depth)]),
            end: index,
            has_cells: (1..3).any(terms.in_cell),
            fault: match (terms.fault, index) {
                (Fault::EarlyWrite, 0) | (Fault::LateCopy, 1) => terms.fault,
                _ => Fault::None,
            },
            early: Cell::new(0),
        };
        let terms = (terms.order[index], terms.in_cell);
        Driver::new(link, words, Arc::clone(&memory), socket, terms)
    };
    (end(sender, one, 0), end(receiver, other, 1))
}

fn limit(terms: Terms, sender: &End, receiver: &End) {
    sender.words.steps.set(terms.steps[0]);
    receiver.words.steps.set(terms.steps[1]);
}

/// Publishes `messages` messages in a separate thread.
fn publishing(mut sender: End, messages: usize) -> thread::JoinHandle<End> {
    thread::spawn(move || {
        for _ in 0..messages {
            sender.publish();
        }
        sender
    })
}

/// Receives until the message `last`, and releases each message that it took.
fn receive_until(receiver: &mut End, last: u64) {
    while receiver.seen.last() < Some(&last) && !receiver.is_over() {
        receiver.receive();
        receiver.release();
    }
}

/// Receives until the link has ended and no message is left.
fn receive_all(receiver: &mut End) {
    while receiver.receive().is_some() {
        receiver.release();
    }
}

/// The number of messages still in the ring.
fn left(end: &End) -> usize {
    let depth = u32::from(end.memory.layout.depth());
    let word = |index| atomic::load(end.memory.word(At::Forward(index)));
    (0..depth).filter(|index| word(*index) != 0).count()
}

/// Asserts that each message was taken or displaced once, or is still in the ring.
fn account(sender: &End, receiver: &End) {
    let mut known = sender.words.displaced.borrow().clone();
    known.extend(&receiver.seen);
    known.sort_unstable();
    let put = sender.words.put.borrow();
    let count = known.len() + left(sender);
    assert_eq!(count, put.len(), "of {put:?} {known:?} are accounted for");
    known.dedup();
    assert_eq!(known.len() + left(sender), put.len(), "one twice");
    assert!(known.iter().all(|it| put.contains(it)), "one from nowhere");
}

/// After both ends have finished, no message is in flight, and every slot is free.
fn settled(mut sender: End, receiver: &End) {
    account(&sender, receiver);
    assert_eq!(left(&sender), 0, "a message is left");
    sender.harvest();
    let in_slots = |ids: &[u64]| -> Vec<u64> {
        let ids = ids.iter().copied();
        ids.filter(|id| !(sender.in_cell)(*id)).collect()
    };
    let mut delivered = sender.settled_as(Fate::Delivered);
    delivered.sort_unstable();
    assert_eq!(
        delivered,
        in_slots(&receiver.seen),
        "given back is what was taken"
    );
    let displaced = sender.words.displaced.borrow();
    assert_eq!(sender.settled_as(Fate::Discarded), in_slots(&displaced));
    let counted = sender.link.counters();
    assert_eq!(counted.delivered, receiver.seen.len() as u64);
    assert_eq!(counted.discarded, displaced.len() as u64);
    assert_eq!(sender.link.in_flight(), 0, "all is settled");
    assert_eq!(sender.free_slots(), sender.memory.slots.len());
}

/// Sends three messages to a receiver that waits for each. It always receives the last one.
pub(crate) fn keep_last(terms: Terms) {
    let (sender, mut receiver) = pair(terms);
    let sender = publishing(sender, 3);
    receive_until(&mut receiver, 3);
    settled(sender.join().unwrap(), &receiver);
}

/// The same with two messages, without the settlements: a machine with a fault settles them wrongly, too.
pub(crate) fn torn(terms: Terms) {
    let (sender, mut receiver) = pair(terms);
    let sender = publishing(sender, 2);
    receive_until(&mut receiver, 2);
    account(&sender.join().unwrap(), &receiver);
}

/// A pair whose window is full: the application holds a message, and the ring is full.
fn full(terms: Terms) -> (End, End) {
    let (mut sender, mut receiver) = pair(terms);
    sender.publish();
    assert_eq!(receiver.take(), Some(1));
    for _ in 0..terms.depth {
        sender.publish();
    }
    assert_eq!(sender.link.in_flight(), terms.depth as usize + 1);
    (sender, receiver)
}

/// With a full window, the sender displaces its oldest message, and harvests.
pub(crate) fn window_full(terms: Terms) {
    let (sender, mut receiver) = full(terms);
    let last = u64::from(terms.depth) + 3;
    let sender = publishing(sender, 2);
    receiver.release();
    receive_until(&mut receiver, last);
    settled(sender.join().unwrap(), &receiver);
}

/// The sender overwrites the ring repeatedly while the receiver takes.
pub(crate) fn round(terms: Terms) {
    let (mut sender, mut receiver) = pair(terms);
    sender.publish();
    sender.publish();
    let sender = publishing(sender, 3);
    for _ in 0..2 {
        receiver.take();
        receiver.release();
    }
    let sender = sender.join().unwrap();
    while receiver.take().is_some() {
        receiver.release();
    }
    assert_eq!(receiver.seen.last(), Some(&5));
    settled(sender, &receiver);
}

/// Three messages. The sender waits for room for each of them. None is lost.
pub(crate) fn reliable(terms: Terms) {
    let (sender, mut receiver) = pair(terms);
    let sender = publishing(sender, 3);
    receive_until(&mut receiver, 3);
    assert_eq!(receiver.seen, [1, 2, 3]);
    settled(sender.join().unwrap(), &receiver);
}

/// A sender waits only for room.
pub(crate) fn room(terms: Terms) {
    let (mut sender, mut receiver) = pair(terms);
    sender.publish();
    let sender = publishing(sender, 1);
    assert_eq!(receiver.take(), Some(1));
    receiver.release();
    let sender = sender.join().unwrap();
    assert_eq!(receiver.take(), Some(2));
    receiver.release();
    settled(sender, &receiver);
}

/// An application holds each message until it has the next one. None is lost.
pub(crate) fn held(terms: Terms) {
    let (sender, mut receiver) = pair(terms);
    let sender = publishing(sender, 3);
    for id in 1..=3 {
        assert_eq!(receiver.receive(), Some(id));
        if id > 1 {
            receiver.release();
        }
    }
    receiver.release();
    settled(sender.join().unwrap(), &receiver);
}

/// The sender waits until all messages are released.
pub(crate) fn flush(terms: Terms) {
    let (mut sender, mut receiver) = pair(terms);
    let sender = thread::spawn(move || {
        sender.publish();
        sender.publish();
        sender.flush();
        assert_eq!(sender.link.in_flight(), 0);
        sender
    });
    receive_until(&mut receiver, 2);
    settled(sender.join().unwrap(), &receiver);
}

/// The sender waits for room, and then until all messages are given back. The receiver takes two
/// messages in one batch, and gives them back in one batch.
pub(crate) fn batch(terms: Terms) {
    let (mut sender, mut receiver) = pair(terms);
    sender.publish();
    sender.publish();
    let sender = thread::spawn(move || {
        sender.publish();
        sender.flush();
        sender
    });
    receiver.take_all();
    receiver.release_all();
    receive_until(&mut receiver, 3);
    assert_eq!(receiver.seen, [1, 2, 3]);
    settled(sender.join().unwrap(), &receiver);
}

/// The sender's process ends after some step. The receiver takes the messages left in the ring, and
/// no others. Returns whether the process ended early.
fn left_behind(mut sender: End, mut receiver: End, messages: usize) -> bool {
    let sender = thread::spawn(move || {
        for _ in 0..messages {
            sender.publish();
        }
        sender.exit();
        sender
    });
    receiver.release();
    receive_all(&mut receiver);
    let sender = sender.join().unwrap();
    assert!(receiver.link.end().is_some(), "the stream has ended");
    account(&sender, &receiver);
    assert_eq!(left(&sender), 0, "a message is left");
    sender.words.is_dead()
}

pub(crate) fn sender_stops(terms: Terms) -> bool {
    let (sender, receiver) = pair(terms);
    limit(terms, &sender, &receiver);
    left_behind(sender, receiver, 2)
}

/// The same, while the sender makes room in a full window.
pub(crate) fn sender_stops_full(terms: Terms) -> bool {
    let (sender, receiver) = full(terms);
    limit(terms, &sender, &receiver);
    left_behind(sender, receiver, 1)
}

/// The receiver's process ends after some step. The sender does not wait for ever, and learns the
/// fate of each message. Returns whether the process ended early.
pub(crate) fn receiver_stops(terms: Terms) -> bool {
    let (mut sender, mut receiver) = pair(terms);
    limit(terms, &sender, &receiver);
    let sender = thread::spawn(move || {
        for _ in 0..2 {
            sender.publish();
        }
        sender.flush();
        sender
    });
    receive_until(&mut receiver, 2);
    receiver.exit();
    let sender = sender.join().unwrap();
    account(&sender, &receiver);
    assert_eq!(sender.link.in_flight(), 0, "all is settled");
    let counted = sender.link.counters();
    assert!(counted.delivered <= receiver.seen.len() as u64);
    let delivered = sender.settled_as(Fate::Delivered);
    let mut taken = receiver.seen.iter();
    assert!(delivered.iter().all(|it| taken.any(|id| id == it)));
    let closed = sender.settled_as(Fate::Closed).len();
    assert_eq!(sender.free_slots() + closed, sender.memory.slots.len());
    receiver.words.is_dead()
}

/// The receiver closes the link and takes the messages left in the ring, while the sender
/// continues.
pub(crate) fn receiver_closes(terms: Terms) {
    let (sender, mut receiver) = pair(terms);
    let sender = publishing(sender, 3);
    receiver.close();
    while receiver.take().is_some() {
        receiver.release();
    }
    receiver.exit();
    let sender = sender.join().unwrap();
    account(&sender, &receiver);
}
