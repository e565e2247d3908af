//! A node with one interface that has a link of each lane: the messages of one come through its socket, and those of
//! the other through a ring.

use std::sync::Arc;

use loom::sync::atomic::{AtomicU64, Ordering, fence};
use loom::thread;

use crate::kernel::{AsFd, Socket, wait_readable};

use self::control::Control;
use self::interface::{DeclaredInterface, Link};
use self::shared_interface::SharedInterface;
use self::shared_node::NodeState;
use super::bell::Bell;
use super::watch::Watch;

/// Two calls of a client: each thread waits for one reply.
const ONE: u64 = 1;
const OTHER: u64 = 2;

/// As in `sm2-node/src/driver/limits.rs`.
pub(crate) mod limits {
    pub(crate) const SHORTAGE_PAUSE: std::time::Duration = std::time::Duration::from_millis(1);
}

pub(crate) mod context {
    pub(crate) struct Context<'a>(pub(super) std::marker::PhantomData<&'a ()>);
}

/// Models `sm2-node/src/driver/interface.rs`, as far as waiting is concerned.
pub(crate) mod interface {
    use std::sync::Arc;

    use super::{AtomicU64, Ordering, Socket, fence};

    /// An interface, reduced to the part that waiting uses.
    #[derive(Debug, Default)]
    pub(crate) struct DeclaredInterface {
        pub(super) ring: Arc<super::Ring>,
        /// The socket of the other link, once the control side has made it.
        pub(super) link: Option<Link>,
        pub(super) messages: Vec<u64>,
        pub(super) is_over: bool,
        /// True if taking a message clears the word that requests the bell for a sleeping thread.
        pub(super) unparks: bool,
    }

    #[derive(Debug)]
    pub(crate) struct Link(pub(super) Arc<Socket>);

    impl DeclaredInterface {
        pub(super) fn park(&mut self) {
            self.ring.parked.swap(1, Ordering::AcqRel);
            fence(Ordering::SeqCst);
        }

        /// Reads the socket. Returns whether something came.
        pub(super) fn read(&mut self) -> bool {
            let Some(Link(socket)) = &self.link else {
                return false;
            };
            let before = self.messages.len();
            self.messages.extend(std::iter::from_fn(|| socket.receive()));
            self.messages.len() > before
        }

        /// Takes a message that came through the socket.
        pub(super) fn take(&mut self, number: u64) -> Option<()> {
            let at = self.messages.iter().position(|&it| it == number)?;
            self.messages.remove(at);
            Some(())
        }

        /// Returns the number of the message in the ring, if it is at most `most`.
        pub(super) fn take_by_ring(&mut self, most: u64) -> Option<u64> {
            let super::Ring { word, parked } = &*self.ring;
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
    }
}

#[path = "shared_interface.rs"]
pub(crate) mod shared_interface;

/// No node is without a background thread here.
pub(crate) mod undriven_control {
    pub(crate) struct UndrivenControl;

    impl UndrivenControl {
        pub(crate) const fn is_of(&self, _: &()) -> bool {
            false
        }
    }
}

/// Models `sm2-node/src/driver/control.rs`.
pub(crate) mod control {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use super::super::sleepers::Sleepers;
    use super::shared_interface::SharedInterface;
    use super::shared_node::NodeSets;

    pub(crate) struct Control {
        pub(in super::super) sleepers: Sleepers,
        pub(crate) short_of_memory: bool,
        pub(crate) interfaces: BTreeMap<u64, Arc<SharedInterface>>,
        pub(super) is_connected: bool,
    }

    impl Control {
        pub(crate) fn ready_interfaces(&mut self, _: &NodeSets) -> Vec<Arc<SharedInterface>> {
            self.interfaces.values().map(Arc::clone).collect()
        }

        pub(crate) fn not_ready(&mut self, _: &dyn std::fmt::Display) {
            self.short_of_memory = true;
        }
    }
}

/// Models `sm2-node/src/driver/shared_node.rs`.
pub(crate) mod shared_node {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use loom::sync::{Mutex, MutexGuard};

    use super::control::Control;
    use crate::kernel::{AsFd, BorrowedFd, Epoll, Waker};

    pub(crate) struct NodeState {
        pub(crate) sets: NodeSets,
        pub(crate) changed: Arc<Waker>,
        control: Mutex<Control>,
    }

    pub(crate) struct NodeSets {
        pub(crate) control: Epoll,
    }

    impl NodeSets {
        /// No thread requests a shutdown here.
        pub(crate) const fn is_shut_down(&self) -> bool {
            false
        }

        pub(crate) const fn shutdown(&self) -> Option<BorrowedFd<'_>> {
            None
        }
    }

    impl AsFd for NodeSets {
        fn as_fd(&self) -> BorrowedFd<'_> {
            self.control.as_fd()
        }
    }

    impl NodeState {
        pub(super) fn new() -> Arc<Self> {
            Arc::new(Self {
                sets: NodeSets {
                    control: Epoll::new().unwrap(),
                },
                changed: Arc::new(Waker::new().unwrap()),
                control: Mutex::new(Control {
                    sleepers: super::sleepers(),
                    short_of_memory: false,
                    interfaces: BTreeMap::default(),
                    is_connected: false,
                }),
            })
        }

        pub(crate) fn lock(&self) -> MutexGuard<'_, Control> {
            self.control.lock().unwrap()
        }

        /// The background thread drives the control side.
        pub(crate) fn lock_driven(&self) -> MutexGuard<'_, Control> {
            self.lock()
        }
    }
}

/// No thread waits yet.
fn sleepers() -> super::sleepers::Sleepers {
    let spare = super::sleepers::SpareWakers::new().unwrap();
    super::sleepers::Sleepers::new(&Arc::new(spare))
}

/// A ring for one message. `tests/ring.rs` tests the rings of SPEC.
#[derive(Debug, Default)]
pub(crate) struct Ring {
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

/// A number that stands for DOORBELL: no thread takes it.
const DOORBELL: u64 = 9;

/// An interface with a link, its socket, and its ring.
struct Linked {
    interface: Arc<SharedInterface>,
    socket: Arc<Socket>,
    ring: Arc<Ring>,
}

impl Linked {
    fn new(unparks: bool) -> Self {
        let (socket, ring) = (Arc::new(Socket::new()), Arc::new(Ring::default()));
        let interface = SharedInterface::new(DeclaredInterface {
            ring: Arc::clone(&ring),
            unparks,
            ..DeclaredInterface::default()
        });
        let linked = Self {
            interface,
            socket,
            ring,
        };
        linked.link();
        linked
    }

    /// An interface without a link: the control side makes the link later.
    fn unlinked() -> Self {
        Self {
            interface: SharedInterface::new(DeclaredInterface::default()),
            socket: Arc::new(Socket::new()),
            ring: Arc::default(),
        }
    }

    /// Hands the link over to the data side, as `Control::linked` does.
    fn link(&self) {
        let calls = &self.interface.sets.calls;
        let link = Link(Arc::clone(&self.socket));
        self.interface.change_from_control(|it| {
            calls.add(&*self.socket, 0, crate::kernel::Interest::READABLE).unwrap();
            it.link = Some(link);
        });
    }

    /// Starts a thread that waits for a message.
    fn waiting(&self, number: u64) -> thread::JoinHandle<()> {
        let interface = Arc::clone(&self.interface);
        thread::spawn(move || take(&interface, number))
    }

    fn peer(&self, sends: impl FnOnce(&Socket, &Ring) + Send + 'static) -> thread::JoinHandle<()> {
        let (socket, ring) = (Arc::clone(&self.socket), Arc::clone(&self.ring));
        thread::spawn(move || sends(&socket, &ring))
    }
}

/// Sends a message on the socket, and then one in the ring, with the bell if its receiver sleeps.
fn send_to_both(socket: &Socket, ring: &Ring) {
    socket.send(OTHER);
    if ring.put(1) {
        socket.send(DOORBELL);
    }
}

fn take(interface: &SharedInterface, number: u64) {
    let found = interface.wait(None, |it, _| it.take(number));
    assert_eq!(found.unwrap(), Some(()));
}

fn take_by_ring(interface: &SharedInterface) -> u64 {
    let found = interface.wait(None, |it, _| it.take_by_ring(u64::MAX));
    found.unwrap().expect("it waits for ever")
}

/// Two threads wait at one interface. The one that reads the socket receives for the other one as well.
pub(crate) fn others() {
    let linked = Linked::new(false);
    let one = linked.waiting(ONE);
    let peer = linked.peer(|socket, _| {
        socket.send(ONE);
        socket.send(OTHER);
    });
    take(&linked.interface, OTHER);
    one.join().unwrap();
    peer.join().unwrap();
}

/// A thread that waits at an interface is told of a change by the control side.
pub(crate) fn control_side() {
    let linked = Linked::unlinked();
    let one = {
        let interface = Arc::clone(&linked.interface);
        thread::spawn(move || {
            let over = interface.wait(None, |it, _| it.is_over.then_some(()));
            assert_eq!(over.unwrap(), Some(()));
        })
    };
    linked.interface.change_from_control(|it| it.is_over = true);
    one.join().unwrap();
}

/// A thread that waits for the session is told of its change.
pub(crate) fn session() {
    let node = NodeState::new();
    let one = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            let connected = node.wait(None, |it| it.is_connected.then_some(()));
            assert_eq!(connected.unwrap(), Some(()));
        })
    };
    let mut control = node.lock();
    control.is_connected = true;
    control.sleepers.wake();
    drop(control);
    one.join().unwrap();
}

/// The control side hands a link over to a thread that waits. A message may be in its socket before.
pub(crate) fn hand_over() {
    let linked = Linked::unlinked();
    let one = linked.waiting(ONE);
    let peer = linked.peer(|socket, _| socket.send(ONE));
    linked.link();
    one.join().unwrap();
    peer.join().unwrap();
}

/// The control side takes a link back at its end: it reads what is left in the socket, while a thread waits for it.
pub(crate) fn take_back() {
    let linked = Linked::new(false);
    let one = linked.waiting(ONE);
    let peer = linked.peer(|socket, _| socket.send(ONE));
    peer.join().unwrap();
    linked.interface.change_from_control(|it| {
        it.read();
        it.is_over = true;
    });
    one.join().unwrap();
}

/// A program polls the descriptor of an interface, and takes a message each time. Meanwhile another thread waits at the
/// same interface and reads its socket.
pub(crate) fn bell() {
    let linked = Linked::new(false);
    let polling = {
        let interface = Arc::clone(&linked.interface);
        thread::spawn(move || {
            let bell = Bell::new(&interface).unwrap();
            let mut missing = 2;
            while missing > 0 {
                assert!(wait_readable(&[bell.as_fd()], None).unwrap());
                let mut locked = interface.lock();
                locked.drive();
                match locked.change(|it, _| it.take(ONE)) {
                    Some(()) => missing -= 1,
                    None => {
                        bell.clear(&mut locked);
                    }
                }
            }
            bell.remove(&interface);
        })
    };
    let peer = linked.peer(|socket, _| {
        socket.send(ONE);
        socket.send(ONE);
        socket.send(OTHER);
    });
    take(&linked.interface, OTHER);
    polling.join().unwrap();
    peer.join().unwrap();
}

/// A thread waits in a wait set for a message in the ring, as `wait_set.rs` does. Another thread waits for a message in
/// the socket, and may receive the bell of the ring.
pub(crate) fn wait_set() {
    let linked = Linked::new(false);
    let other = linked.waiting(OTHER);
    let peer = linked.peer(send_to_both);
    let watch = Watch::new(&linked.interface).unwrap();
    let set = crate::kernel::Epoll::new().unwrap();
    for descriptor in watch.descriptors() {
        let readable = crate::kernel::Interest::READABLE;
        set.add(&descriptor, 0, readable).unwrap();
    }
    let is_found = std::cell::Cell::new(false);
    let look = |it: &mut DeclaredInterface, _: &mut context::Context<'_>| {
        is_found.set(is_found.get() || it.take_by_ring(u64::MAX).is_some());
        is_found.get()
    };
    watch.look(look);
    while !is_found.get() {
        assert!(wait_readable(&[set.as_fd()], None).unwrap());
        watch.read_and_look(look);
    }
    other.join().unwrap();
    peer.join().unwrap();
}

/// A message arrives on the socket for one thread, and then one in the ring for another. The thread that reads the
/// socket may receive the bell of the ring.
pub(crate) fn ring() {
    let linked = Linked::new(false);
    let other = linked.waiting(OTHER);
    let peer = linked.peer(send_to_both);
    assert_eq!(take_by_ring(&linked.interface), 1);
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
    let linked = Linked::new(unparks);
    let other = {
        let interface = Arc::clone(&linked.interface);
        thread::spawn(move || {
            interface.lock().change(|it, _| it.take_by_ring(1));
        })
    };
    let peer = linked.peer(|socket, ring| {
        for number in [1, 2] {
            if ring.put(number) {
                socket.send(DOORBELL);
            }
        }
    });
    while take_by_ring(&linked.interface) < 2 {}
    other.join().unwrap();
    peer.join().unwrap();
}
