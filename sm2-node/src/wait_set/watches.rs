//! The interfaces, control sides and shutdown handles that a wait set watches.
//!
//! A wait set registers a waker at each interface, and has the socket set and the waker of each in one epoll set. After
//! an event it looks at that interface under its lock, so a report means that something is there; in this way it also
//! tells two pending calls of one client apart. Before it sleeps, it looks at the interfaces that it reported last, and
//! parks their rings (`driver/watch.rs`, checked with loom). Each wait is therefore one `epoll` call, and an interface
//! without an event costs nothing. The descriptor that each interface has for foreign loops would be one more epoll set
//! for each source, and one more level of nesting for each wake-up.

use std::collections::HashMap;
use std::io;
use std::os::fd::AsFd;
use std::sync::Arc;

use sm2_io::{Epoll, Interest};

use super::Key;
use super::sources::Sources;
use crate::Shutdown;
use crate::driver::{SharedInterface, UndrivenControl, Watch};

/// The interfaces, control sides and shutdown handles that a wait set watches, each once, by their tokens.
#[derive(Debug, Default)]
pub(super) struct Watches {
    interfaces: HashMap<u64, Watched>,
    controls: HashMap<u64, Driven>,
    shutdowns: Vec<Shutdown>,
    /// The interfaces to look at before the next sleep.
    again: Vec<u64>,
}

#[derive(Debug)]
struct Watched {
    watch: Watch,
    /// The sources of this interface.
    keys: Vec<Key>,
    /// Whether it is in `again`.
    is_listed: bool,
}

/// The control side of a node without a background thread.
#[derive(Debug)]
struct Driven {
    control: UndrivenControl,
    /// Whether it is driven without a source of its node in the set.
    is_pinned: bool,
}

impl Watches {
    /// Adds a source of an interface. Returns the token of the interface: `token`, unless the set watches it already.
    pub(super) fn add(
        &mut self,
        epoll: &Epoll,
        interface: &Arc<SharedInterface>,
        token: u64,
        key: Key,
    ) -> io::Result<u64> {
        let mut watched = self.interfaces.iter_mut();
        if let Some((&token, watched)) = watched.find(|(_, it)| it.watch.is_of(interface)) {
            watched.keys.push(key);
            self.look_again(token);
            return Ok(token);
        }
        let watch = Watch::new(interface)?;
        let [sockets, waker] = watch.descriptors();
        epoll.add(sockets, token, Interest::READABLE)?;
        if let Err(error) = epoll.add(waker, token, Interest::READABLE) {
            let _ = epoll.remove(sockets);
            return Err(error);
        }
        let watched = Watched {
            watch,
            keys: vec![key],
            is_listed: false,
        };
        self.interfaces.insert(token, watched);
        // There may be something already.
        self.look_again(token);
        Ok(token)
    }

    /// Removes a source of an interface.
    pub(super) fn remove(&mut self, epoll: &Epoll, token: u64, key: Key) {
        let Some(watched) = self.interfaces.get_mut(&token) else {
            return;
        };
        watched.keys.retain(|&it| it != key);
        if watched.keys.is_empty() {
            for descriptor in watched.watch.descriptors() {
                let _ = epoll.remove(descriptor);
            }
            self.interfaces.remove(&token);
            self.remove_unused_controls(epoll);
        }
    }

    fn remove_unused_controls(&mut self, epoll: &Epoll) {
        let interfaces = &self.interfaces;
        self.controls.retain(|_, Driven { control, is_pinned }| {
            let is_used = |it: &Watched| it.watch.is_driven_by(control);
            let keep = *is_pinned || interfaces.values().any(is_used);
            if !keep {
                let _ = epoll.remove(&*control);
            }
            keep
        });
    }

    /// Drives this control side while the set waits: until the last source of its node is removed, or for ever
    /// (`is_pinned`).
    pub(super) fn drive(
        &mut self,
        epoll: &Epoll,
        control: UndrivenControl,
        is_pinned: bool,
        token: u64,
    ) -> io::Result<()> {
        let mut controls = self.controls.values_mut();
        if let Some(driven) = controls.find(|it| it.control.is_same(&control)) {
            driven.is_pinned |= is_pinned;
            return Ok(());
        }
        epoll.add(&control, token, Interest::READABLE)?;
        let driven = Driven { control, is_pinned };
        self.controls.insert(token, driven);
        Ok(())
    }

    pub(super) fn end_with(
        &mut self,
        epoll: &Epoll,
        shutdown: &Shutdown,
        token: u64,
    ) -> io::Result<()> {
        epoll.add(shutdown.as_fd(), token, Interest::READABLE)?;
        self.shutdowns.push(shutdown.clone());
        Ok(())
    }

    pub(super) fn is_shut_down(&self) -> bool {
        self.shutdowns.iter().any(Shutdown::is_requested)
    }

    /// Looks at an interface before the next sleep.
    pub(super) fn look_again(&mut self, token: u64) {
        if let Some(watched) = self.interfaces.get_mut(&token)
            && !watched.is_listed
        {
            watched.is_listed = true;
            self.again.push(token);
        }
    }

    /// Looks at the interfaces that are listed. If the kernel has no memory for one, its descriptor is ready still, and
    /// [`handle`](Self::handle) says so.
    pub(super) fn look<T>(&mut self, sources: &mut Sources<'_, T>) {
        for token in self.again.drain(..) {
            // It may have been removed meanwhile.
            if let Some(watched) = self.interfaces.get_mut(&token) {
                watched.is_listed = false;
                let Watched { watch, keys, .. } = watched;
                watch.look(|interface, context| sources.look(keys, interface, context));
            }
        }
    }

    /// Handles an event of the descriptor with this token. Returns whether the kernel had no memory for it.
    pub(super) fn handle<T>(&self, token: u64, sources: &mut Sources<'_, T>) -> bool {
        if let Some(Watched { watch, keys, .. }) = self.interfaces.get(&token) {
            return watch
                .read_and_look(|interface, context| sources.look(keys, interface, context));
        }
        (self.controls.get(&token)).is_some_and(|it| it.control.drive())
    }
}
