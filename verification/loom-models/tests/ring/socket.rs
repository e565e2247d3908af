//! Two ends of a socket: queues of datagrams, and sleeping until a datagram can be read. System
//! calls order memory, and so do the locks here. Only the writer and the reader of a queue take its
//! lock.

use std::collections::VecDeque;
use std::sync::Arc;

use loom::sync::{Condvar, Mutex};

/// One end of a socket. Dropping it closes it.
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
    /// No datagram is queued.
    Nothing,
    /// The other end is closed, and everything that it sent was read.
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

    /// Does not wait. A queue that has a datagram drops the new one, like the fullest possible
    /// socket.
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
