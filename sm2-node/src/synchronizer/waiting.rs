//! Waiting for the sets of a synchronizer.

use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::sync::Arc;
use std::time::Duration;

use super::sets::Synchronizer;
use crate::driver::{Condition, SharedInterface, Until};
use crate::wait_set::{Interest, Key, Source};
use crate::{RecvError, Shutdown, WaitSet};

impl<S> Synchronizer<S> {
    /// Waits for the next set, without a time limit.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn recv(&mut self) -> Result<S, RecvError> {
        loop {
            if let Some(set) = self.recv_until(Until::Forever)? {
                return Ok(set);
            }
        }
    }

    /// Waits for the next set, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn recv_timeout(&mut self, timeout: Duration) -> Result<Option<S>, RecvError> {
        self.recv_until(Until::In(timeout))
    }

    fn recv_until(&mut self, until: Until) -> Result<Option<S>, RecvError> {
        let end = until.moment(crate::now());
        loop {
            if self.shutdowns().any(Shutdown::is_requested) {
                return Err(RecvError::Shutdown);
            }
            let set = self.try_recv()?;
            if set.is_some() || end.is_some_and(|end| end <= crate::now()) {
                return Ok(set);
            }
            let mut own_set = match self.own_set.take() {
                Some(set) => set,
                None => self.make_own_set().map_err(RecvError::Io)?,
            };
            let waited = own_set.wait_until(end.into());
            self.own_set = Some(own_set);
            waited?;
        }
    }

    fn make_own_set(&mut self) -> io::Result<WaitSet<'static, ()>> {
        let mut set = WaitSet::new()?;
        set.add_synchronizer(self, ())?;
        // Several inputs can have the same one.
        let mut added = Vec::new();
        for shutdown in self.shutdowns() {
            let descriptor = shutdown.as_fd().as_raw_fd();
            if !added.contains(&descriptor) {
                set.end_with(shutdown)?;
                added.push(descriptor);
            }
        }
        Ok(set)
    }
}

impl<T: Clone> WaitSet<'_, T> {
    /// Adds a synchronizer: its topics, and a descriptor. All of them have this tag. The set reports it again and again
    /// until [`Synchronizer::try_recv`] returns `None`.
    ///
    /// # Errors
    ///
    /// As [`add`](Self::add). After an error, nothing is added.
    pub fn add_synchronizer<S>(
        &mut self,
        synchronizer: &mut Synchronizer<S>,
        tag: T,
    ) -> io::Result<Vec<Key>> {
        let bell = synchronizer.bell()?;
        let mut keys = vec![self.add_descriptor(bell, Interest::Readable, tag.clone())?];
        for interface in synchronizer.interfaces() {
            match self.add(&Topic(interface), tag.clone()) {
                Ok(key) => keys.push(key),
                Err(error) => {
                    for key in keys {
                        self.remove(key);
                    }
                    return Err(error);
                }
            }
        }
        Ok(keys)
    }
}

/// The messages of an input.
struct Topic<'a>(&'a Arc<SharedInterface>);

impl Source for Topic<'_> {
    fn interface(&self) -> &Arc<SharedInterface> {
        self.0
    }

    fn condition(&self) -> Condition {
        Condition::Message
    }
}
