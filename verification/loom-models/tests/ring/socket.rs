//! Two ends of a socket: queues of datagrams, and sleeping until there is something to read.
//! System calls order memory, as the locks here do. Only the writer and the reader of a queue take
//! its lock.

use std::collections::VecDeque;
use std::sync::Arc;

use loom::sync::{Condvar, Mutex};

/// One end of a socket. To drop it is to close it.
pub(crate) struct Socket {
    reads: Arc<Queue>,
    writes: Arc<Queue>,
}

#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    datagrams: VecDeque<Vec<u8>>,
    closed: bool,
}

/// The next item of a socket.
pub(crate) enum Read {
    Datagram(Vec<u8>),
    /// Nothing at this moment.
    Nothing,
    /// The other end is closed, and all that it sent was read.
    Closed,
}

impl Socket {
    pub(crate) fn pair() -> (Self, Self) {
        let (there, back) = (Arc::<Queue>::default(), Arc::<Queue>::default());
        let one = Self {
            reads: Arc::clone(&back),
            writes: Arc::clone(&there),
        };
        let other = Self {
            reads: there,
            writes: back,
        };
        (one, other)
    }

    /// Does not wait: one that has a datagram takes no other, which is a socket as full as any.
    pub(crate) fn send(&self, datagram: &[u8]) {
        let mut state = self.writes.state.lock().unwrap();
        if state.datagrams.is_empty() {
            state.datagrams.push_back(datagram.to_vec());
        }
        drop(state);
        self.writes.changed.notify_all();
    }

    pub(crate) fn receive(&self) -> Read {
        let mut state = self.reads.state.lock().unwrap();
        match state.datagrams.pop_front() {
            Some(datagram) => Read::Datagram(datagram),
            None if state.closed => Read::Closed,
            None => Read::Nothing,
        }
    }

    pub(crate) fn sleep_until_readable(&self) {
        let mut state = self.reads.state.lock().unwrap();
        while state.datagrams.is_empty() && !state.closed {
            state = self.reads.changed.wait(state).unwrap();
        }
    }

    pub(crate) fn close(&self) {
        self.writes.state.lock().unwrap().closed = true;
        self.writes.changed.notify_all();
    }
}
