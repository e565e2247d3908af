//! A node with two interfaces whose messages arrive through one socket.

use std::collections::BTreeMap;

use loom::sync::atomic::{AtomicU64, Ordering, fence};
use loom::sync::{Arc, Mutex, MutexGuard};
use loom::thread;
use sm2_proto::{Instant, InterfaceId};

use crate::kernel::{AsFd, Epoll, Interest, Socket, wait_readable};

use super::bell::Bell;
use super::sleepers::{Sleepers, EventSource};

const ONE: InterfaceId = InterfaceId(1);
const OTHER: InterfaceId = InterfaceId(2);

/// As in `sm2-node/src/driver/limits.rs`.
pub(crate) mod limits {
    pub(crate) const SHORTAGE_PAUSE: std::time::Duration = std::time::Duration::from_millis(1);
}

/// Models `sm2-node/src/driver/shared_node.rs` and `inner.rs`, as far as waiting is concerned.
pub(crate) struct SharedNode {
    pub(crate) epoll: Epoll,
    socket: Arc<Socket>,
    inner: Mutex<Inner>,
}

pub(crate) struct Inner {
    pub(super) sleepers: Sleepers,
    pub(super) interfaces: BTreeMap<InterfaceId, Interface>,
    /// Memory is never short in these models.
    pub(super) short_of_memory: bool,
    socket: Arc<Socket>,
    messages: Vec<InterfaceId>,
    ended: bool,
}

/// An interface with one link of the ring lane, reduced to the part that waiting uses.
pub(crate) struct Interface {
    ring: Arc<Ring>,
    link: Link,
    /// True if taking a message clears the word by which a sleeping thread requests the bell.
    unparks: bool,
}

impl Interface {
    pub(super) fn park(&mut self) {
        self.ring.parked.swap(1, Ordering::AcqRel);
        fence(Ordering::SeqCst);
    }

    /// Returns the number of the message in the ring, if it is at most `most`.
    fn take(&mut self, most: u64) -> Option<u64> {
        let Ring { word, parked } = &*self.ring;
        loop {
            let number = word.load(Ordering::Acquire);
            if number == 0 || number > most {
                return None;
            }
            let taken = word.compare_exchange(number, 0, Ordering::AcqRel, Ordering::Relaxed);
            if taken.is_ok() {
                if self.unparks {
                    parked.swap(0, Ordering::AcqRel);
                }
                return Some(number);
            }
        }
    }

    pub(super) fn may_take(&self) -> bool {
        self.ring.word.load(Ordering::Acquire) != 0
    }

    pub(super) const fn open_links(&self) -> usize {
        1
    }

    pub(super) fn links(&self) -> impl Iterator<Item = &Link> {
        std::iter::once(&self.link)
    }
}

pub(crate) struct Link;

impl Link {
    pub(super) const fn is_woken_by_socket(&self) -> bool {
        false
    }

    pub(super) const fn is_open(&self) -> bool {
        true
    }
}

/// A ring for one message. `tests/ring.rs` tests the rings of SPEC.
#[derive(Default)]
struct Ring {
    word: AtomicU64,
    parked: AtomicU64,
}

impl Ring {
    /// Puts a message. Returns true if the receiver wants the bell.
    fn put(&self, number: u64) -> bool {
        self.word.swap(number, Ordering::AcqRel);
        fence(Ordering::SeqCst);
        self.parked.load(Ordering::Acquire) != 0 && self.parked.swap(0, Ordering::AcqRel) == 1
    }
}

impl SharedNode {
    fn new() -> Arc<Self> {
        let (epoll, socket) = (Epoll::new().unwrap(), Arc::new(Socket::new()));
        epoll.add(&*socket, 0, Interest::READABLE).unwrap();
        let inner = Mutex::new(Inner {
            sleepers: Sleepers::new().unwrap(),
            interfaces: BTreeMap::new(),
            short_of_memory: false,
            socket: Arc::clone(&socket),
            messages: Vec::new(),
            ended: false,
        });
        Arc::new(Self {
            epoll,
            socket,
            inner,
        })
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap()
    }

    pub(crate) fn lock_driven(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.lock();
        inner.drive(&self.epoll);
        inner
    }

    fn take(&self, interface: InterfaceId) {
        let found = self.wait(EventSource::Interface(interface), None, |inner| {
            inner.take(interface)
        });
        assert_eq!(found.unwrap(), Some(()));
    }

    fn take_by_ring(&self) -> u64 {
        let found = self.wait(EventSource::Interface(ONE), None, |inner| {
            let interface = inner.interfaces.get_mut(&ONE);
            interface.and_then(|it| it.take(u64::MAX))
        });
        found.unwrap().expect("it waits for ever")
    }
}

impl Inner {
    /// Never due in these models: that is the case in which the sockets are read least.
    pub(super) fn drive_if_due(&mut self, _: Instant, _: &Epoll) -> bool {
        false
    }

    pub(super) fn drive(&mut self, _: &Epoll) {
        while let Some(interface) = self.socket.receive() {
            self.messages.push(interface);
            self.sleepers.wake(EventSource::Interface(interface));
        }
    }

    fn take(&mut self, interface: InterfaceId) -> Option<()> {
        let at = self.messages.iter().position(|&it| it == interface)?;
        self.messages.remove(at);
        Some(())
    }
}

/// A peer sends to both interfaces, and a thread waits at each. The thread that drives the node
/// receives for the other one as well.
pub(crate) fn others() {
    let node = SharedNode::new();
    let one = {
        let node = Arc::clone(&node);
        thread::spawn(move || node.take(ONE))
    };
    let peer = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            node.socket.send(ONE);
            node.socket.send(OTHER);
        })
    };
    node.take(OTHER);
    one.join().unwrap();
    peer.join().unwrap();
}

/// A thread that waits for an interface is told of the end of the session.
pub(crate) fn session() {
    let node = SharedNode::new();
    let one = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            let ended = node.wait(EventSource::Interface(ONE), None, |it| it.ended.then_some(()));
            assert_eq!(ended.unwrap(), Some(()));
        })
    };
    let mut inner = node.lock();
    inner.ended = true;
    inner.sleepers.wake(EventSource::Session);
    drop(inner);
    one.join().unwrap();
}

/// A program polls the descriptor of one interface, and takes a message each time. Meanwhile
/// another thread waits at the other interface and drives the node.
pub(crate) fn bell() {
    let node = SharedNode::new();
    let polling = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            let bell = Bell::new(&node, ONE).unwrap();
            let mut missing = 2;
            while missing > 0 {
                assert!(wait_readable(&[bell.as_fd()], None).unwrap());
                let mut inner = node.lock_driven();
                match inner.take(ONE) {
                    Some(()) => missing -= 1,
                    None => {
                        bell.silence(&mut inner);
                    }
                }
            }
            bell.remove(&mut node.lock());
        })
    };
    let peer = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            node.socket.send(ONE);
            node.socket.send(ONE);
            node.socket.send(OTHER);
        })
    };
    node.take(OTHER);
    polling.join().unwrap();
    peer.join().unwrap();
}

/// A message arrives in a ring for one thread, and one on a socket for another. The thread that
/// drives the node receives the bell of the ring.
pub(crate) fn ring() {
    let (node, ring) = with_ring(false);
    let other = {
        let node = Arc::clone(&node);
        thread::spawn(move || node.take(OTHER))
    };
    let peer = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            if ring.put(1) {
                node.socket.send(ONE);
            }
            node.socket.send(OTHER);
        })
    };
    assert_eq!(node.take_by_ring(), 1);
    other.join().unwrap();
    peer.join().unwrap();
}

/// Two threads share a subscriber. One sleeps until the last message arrives; the other takes the
/// first message if it is there.
pub(crate) fn shared() {
    shared_as(false);
}

/// A forbidden case: the thread that takes a message clears the flag of sleepers.
pub(crate) fn shared_unparked() {
    shared_as(true);
}

fn shared_as(unparks: bool) {
    let (node, ring) = with_ring(unparks);
    let other = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            let mut inner = node.lock();
            inner.interfaces.get_mut(&ONE).and_then(|it| it.take(1));
        })
    };
    let peer = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            for number in [1, 2] {
                if ring.put(number) {
                    node.socket.send(ONE);
                }
            }
        })
    };
    while node.take_by_ring() < 2 {}
    other.join().unwrap();
    peer.join().unwrap();
}

fn with_ring(unparks: bool) -> (Arc<SharedNode>, Arc<Ring>) {
    let (node, ring) = (SharedNode::new(), Arc::new(Ring::default()));
    let interface = Interface {
        ring: Arc::clone(&ring),
        link: Link,
        unparks,
    };
    node.lock().interfaces.insert(ONE, interface);
    (node, ring)
}
