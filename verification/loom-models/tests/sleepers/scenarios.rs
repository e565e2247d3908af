//! A node with two interfaces, whose messages come through one socket.

use loom::sync::{Arc, Mutex, MutexGuard};
use loom::thread;
use sm2_proto::InterfaceId;

use crate::kernel::{AsFd, Epoll, Interest, Socket, wait_readable};

use super::wait::{Bell, Sleepers, Topic};

const ONE: InterfaceId = InterfaceId(1);
const OTHER: InterfaceId = InterfaceId(2);

/// As in `sm2-node/src/driver/mod.rs`, as far as waiting goes.
pub(crate) struct Shared {
    pub(crate) epoll: Epoll,
    socket: Socket,
    inner: Mutex<Inner>,
}

pub(crate) struct Inner {
    pub(super) sleepers: Sleepers,
    messages: Vec<InterfaceId>,
    ended: bool,
}

impl Shared {
    fn new() -> Arc<Self> {
        let (epoll, socket) = (Epoll::new().unwrap(), Socket::new());
        epoll.add(&socket, 0, Interest::READABLE).unwrap();
        let inner = Mutex::new(Inner {
            sleepers: Sleepers::new().unwrap(),
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

    pub(crate) fn driven(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.lock();
        while let Some(interface) = self.socket.receive() {
            inner.messages.push(interface);
            inner.sleepers.wake(Topic::Interface(interface));
        }
        inner
    }

    fn take(&self, interface: InterfaceId) {
        let found = self.wait(Topic::Interface(interface), None, |inner| {
            inner.take(interface)
        });
        assert_eq!(found.unwrap(), Some(()));
    }
}

impl Inner {
    fn take(&mut self, interface: InterfaceId) -> Option<()> {
        let at = self.messages.iter().position(|&it| it == interface)?;
        self.messages.remove(at);
        Some(())
    }
}

/// A peer sends to both interfaces, and a thread waits at each: whoever drives the node
/// receives for the other one as well.
pub(crate) fn others() {
    let node = Shared::new();
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

/// A thread that waits for an interface hears of the end of the session.
pub(crate) fn session() {
    let node = Shared::new();
    let one = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            let ended = node.wait(Topic::Interface(ONE), None, |it| it.ended.then_some(()));
            assert_eq!(ended.unwrap(), Some(()));
        })
    };
    let mut inner = node.lock();
    inner.ended = true;
    inner.sleepers.wake(Topic::Session);
    drop(inner);
    one.join().unwrap();
}

/// A program polls the descriptor of one interface, and takes a message each time, while
/// another thread waits at the other interface and drives the node.
pub(crate) fn bell() {
    let node = Shared::new();
    let polling = {
        let node = Arc::clone(&node);
        thread::spawn(move || {
            let bell = Bell::new(&node, ONE).unwrap();
            let mut missing = 2;
            while missing > 0 {
                assert!(wait_readable(&[bell.as_fd()], None).unwrap());
                let mut inner = node.driven();
                match inner.take(ONE) {
                    Some(()) => missing -= 1,
                    None => bell.silence(&mut inner),
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
