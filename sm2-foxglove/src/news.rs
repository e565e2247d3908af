//! The state of the domain, handed from the thread that follows it to those of the viewers.

use std::{
    io::{self, Read, Write},
    os::{
        fd::{AsFd, BorrowedFd},
        unix::net::UnixStream,
    },
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
};

use crate::catalogue::Snapshot;

/// The newest state of the domain.
#[derive(Debug, Default)]
pub(crate) struct News {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    snapshot: Arc<Snapshot>,
    bells: Vec<Weak<UnixStream>>,
}

/// Wakes the thread of a viewer. It is readable while there may be a new state.
#[derive(Debug)]
pub(crate) struct Bell {
    reader: UnixStream,
    /// [`News`] has a weak reference, which ends with the bell.
    _writer: Arc<UnixStream>,
}

impl News {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The newest state.
    pub(crate) fn snapshot(&self) -> Arc<Snapshot> {
        Arc::clone(&self.lock().snapshot)
    }

    /// Replaces the state, and rings all bells.
    pub(crate) fn publish(&self, snapshot: Snapshot) {
        let mut state = self.lock();
        state.snapshot = Arc::new(snapshot);
        state.bells.retain(|bell| match bell.upgrade() {
            Some(bell) => {
                // A bell whose buffer is full rings already.
                let _ = (&*bell).write(&[0]);
                true
            }
            None => false,
        });
    }

    /// A new bell.
    ///
    /// # Errors
    ///
    /// The process has too many descriptors.
    pub(crate) fn bell(&self) -> io::Result<Bell> {
        let (reader, writer) = UnixStream::pair()?;
        reader.set_nonblocking(true)?;
        writer.set_nonblocking(true)?;
        let writer = Arc::new(writer);
        self.lock().bells.push(Arc::downgrade(&writer));
        Ok(Bell {
            reader,
            _writer: writer,
        })
    }
}

impl Bell {
    /// Reads all rings of the bell, before the caller looks at the state.
    pub(crate) fn drain(&self) {
        while matches!((&self.reader).read(&mut [0; 64]), Ok(64)) {}
    }
}

impl AsFd for Bell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.reader.as_fd()
    }
}
