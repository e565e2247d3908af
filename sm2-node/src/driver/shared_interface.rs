//! One interface with its lock: the data side of a node.
//!
//! Each interface has its own lock, so two threads that use two publishers of one node do not contend: `cargo run
//! --release -p sm2-node --example two_threads` printed 0.99 times the rate of two processes. A thread that waits for
//! one interface does not wake for the messages of another. A call that finds work for the control side, such as the
//! end of a link, leaves it as a result, which is handled after the interface is unlocked. Loom's models hand a link
//! from the control side to the data side, and back at its end. The price is one more descriptor for each interface,
//! its epoll set.

use std::fmt::{self, Display};
use std::mem;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sm2_io::{Event, Events};
use sm2_proto::{Instant, InterfaceId, LinkId, Name};

use super::context::Context;
use super::event_sets::LinkSets;
use super::interface::{DeclaredInterface, ForControl, State};
use super::limited_warning::LimitedWarning;
use super::limits::{ENDS, SOCKETS, SOCKETS_WAIT_NS, put_ends_last};
use super::link::LinkDriver;
use super::next_words::NextWords;
use super::origin::GiveBack;
use super::pace::Pace;
use super::sleepers::Sleepers;
use super::token::LinkToken;

/// One interface, as its handles, its samples and the control side share it.
#[derive(Debug)]
pub(crate) struct SharedInterface {
    pub(crate) id: InterfaceId,
    pub(super) sets: LinkSets,
    control: Arc<dyn ControlSide>,
    driver: Mutex<InterfaceDriver>,
}

/// The two ends of a client's link, as far as the client knows them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LinkEnds {
    id: LinkId,
    client: (Name, InterfaceId),
    server: (Name, InterfaceId),
}

/// The control side of the node, as its interfaces use it.
pub(crate) trait ControlSide: fmt::Debug + Send + Sync {
    /// Does the work of all pending events of the control set. Returns whether the kernel had no memory for it.
    fn drive(&self) -> bool;

    /// Handles the results of a call of an interface.
    fn handle(&self, interface: InterfaceId, results: ForControl);
}

/// An interface, and what a call needs to read and write the sockets of its links, under the interface's lock.
#[derive(Debug)]
pub(crate) struct InterfaceDriver {
    interface: DeclaredInterface,
    node_name: Name,
    /// The threads that wait for the interface, and the descriptor that its program polls.
    pub(super) sleepers: Sleepers,
    events: Events,
    ready: Vec<Event>,
    /// The time of the last drive.
    last_drive: Instant,
    /// The time when the current call began.
    pub(super) now: Instant,
    /// Whether the sockets were read when the current call entered.
    pub(crate) is_driven: bool,
    /// Whether a socket was ready in the last drive, but the kernel had no memory to use it. The socket is still
    /// ready, so a thread that waits for it pauses first (SM2-TRN-013).
    pub(super) short_of_memory: bool,
    /// The warnings about a shortage of memory.
    shortages: LimitedWarning,
    /// How fast the program takes messages.
    pub(super) pace: Pace,
}

/// The locked interface. When this value is dropped, the lock is released, and then the control side handles the
/// results of the call.
pub(crate) struct LockedInterface<'a> {
    shared: &'a SharedInterface,
    /// `None` while this value is being dropped.
    driver: Option<MutexGuard<'a, InterfaceDriver>>,
}

/// Whether a call reads the sockets of its interface before it looks: those of the links, and without a background
/// thread that of the session.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Drive {
    /// It does not read them.
    No,
    /// It reads them.
    Yes,
    /// It reads them if the last time was some time ago.
    IfDue,
    /// It reads them if the last time was some time ago, or if a link has no ring.
    UnlessRings,
    /// It reads them if the last time was some time ago, or if this link has no ring.
    UnlessRing(LinkToken),
}

impl SharedInterface {
    pub(super) fn new(
        id: InterfaceId,
        node: &Name,
        control: Arc<dyn ControlSide>,
        sets: LinkSets,
        interface: DeclaredInterface,
    ) -> Self {
        Self {
            id,
            driver: Mutex::new(InterfaceDriver {
                interface,
                node_name: node.clone(),
                sleepers: sets.sleepers(),
                events: Events::with_capacity(SOCKETS),
                ready: Vec::with_capacity(SOCKETS),
                last_drive: Instant(0),
                now: Instant(0),
                is_driven: false,
                short_of_memory: false,
                shortages: LimitedWarning::default(),
                pace: Pace::default(),
            }),
            sets,
            control,
        }
    }

    /// Locks the interface. If another thread panicked under the lock, the state is still consistent: the only user
    /// code that runs under the lock is a `tracing` subscriber, which must not call this node.
    #[inline]
    pub(crate) fn lock(&self) -> LockedInterface<'_> {
        LockedInterface {
            shared: self,
            driver: Some(self.lock_for_control()),
        }
    }

    /// Locks the interface for a call that begins now, and reads sockets first as `drive` says.
    #[inline]
    pub(crate) fn enter(&self, drive: Drive) -> LockedInterface<'_> {
        self.enter_at(sm2_io::clock::now(), drive)
    }

    /// The same as [`enter`](Self::enter), for a call that began at `now`.
    #[inline]
    pub(crate) fn enter_at(&self, now: Instant, drive: Drive) -> LockedInterface<'_> {
        self.begin(self.lock(), now, drive)
    }

    /// Locks the interface, reads the clock while the next messages are on their way from the cores of their senders,
    /// and reads sockets as [`Drive::IfDue`] says. Returns the time as well.
    #[inline]
    pub(super) fn enter_prefetched(&self) -> (LockedInterface<'_>, Instant) {
        let locked = self.lock();
        locked.interface.links.iter().for_each(LinkDriver::prefetch);
        let now = sm2_io::clock::now();
        (self.begin(locked, now, Drive::IfDue), now)
    }

    /// Begins a call, for [`enter`](Self::enter).
    #[inline]
    pub(super) fn begin<'a>(
        &'a self,
        mut locked: LockedInterface<'a>,
        now: Instant,
        drive: Drive,
    ) -> LockedInterface<'a> {
        let driver = DerefMut::deref_mut(&mut locked);
        if driver.needs(drive, now) {
            return self.drive_and_lock(locked, now);
        }
        (driver.now, driver.is_driven) = (now, false);
        locked
    }

    /// Drives the control side, if calls have to, and the links.
    fn drive_and_lock<'a>(
        &'a self,
        mut locked: LockedInterface<'a>,
        now: Instant,
    ) -> LockedInterface<'a> {
        if !self.sets.has_background() {
            drop(locked);
            self.drive_control();
            locked = self.lock();
        }
        locked.drive_at(now);
        locked.is_driven = true;
        locked
    }

    /// The two ends of a link of this client.
    pub(crate) fn link_ends(&self, token: LinkToken) -> Option<LinkEnds> {
        let locked = self.lock();
        let link = locked.interface.links.get(token)?;
        Some(LinkEnds {
            id: link.id,
            client: (locked.node_name.clone(), self.id),
            server: (link.origin.peer.name.clone(), link.origin.peer.interface),
        })
    }

    /// Whether this is the server at the other end of a client's link. Numbers of links are those of a domain, so the
    /// names and numbers of both ends are compared as well.
    pub(crate) fn is_receiving_end(&self, ends: &LinkEnds) -> bool {
        let locked = self.lock();
        self.id == ends.server.1
            && locked.node_name == ends.server.0
            && locked.interface.links.iter().any(|it| {
                let (name, interface) = &ends.client;
                it.id == ends.id
                    && it.origin.peer.name == *name
                    && it.origin.peer.interface == *interface
            })
    }

    /// Whether the program has requested a shutdown.
    #[inline]
    pub(crate) fn is_shut_down(&self) -> bool {
        self.sets.is_shut_down()
    }

    /// Does the work of all pending events of the control side.
    pub(super) fn drive_control(&self) {
        self.control.drive();
    }

    /// The control side of its node.
    pub(super) fn control_side(&self) -> Arc<dyn ControlSide> {
        Arc::clone(&self.control)
    }

    /// Whether the Manager of this session has granted the interface. Meaningful once that Manager knows all interfaces
    /// of the node.
    pub(super) fn is_granted(&self) -> bool {
        self.lock_for_control().interface.is_granted()
    }

    /// The progress of the declaration.
    pub(super) fn state(&self) -> State {
        self.lock_for_control().interface.state.clone()
    }

    /// Drives the links of the interface.
    pub(super) fn drive(&self) {
        self.lock().drive();
    }

    /// Prepares the interface for a sleep until the node has any event. Returns whether a ring may already have a
    /// message, and whether the last drive was short of memory.
    pub(super) fn park_for_program(&self) -> (bool, bool) {
        let mut locked = self.lock_for_control();
        locked.park();
        (locked.interface.links.may_take(), locked.short_of_memory)
    }

    /// Locks the interface for the control side, which must not call anything that leaves results.
    fn lock_for_control(&self) -> MutexGuard<'_, InterfaceDriver> {
        self.driver.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the interface for the control side, which holds the node's lock and handles the results itself.
    pub(super) fn change_from_control<R>(
        &self,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> (R, Option<ForControl>) {
        let mut driver = self.lock_for_control();
        let result = driver.change(&self.sets, change);
        driver.sleepers.wake();
        (result, driver.interface.take_for_control())
    }

    /// Ticks the deadlines for the control side. Only an event, or a socket that the tick has read, wakes the threads
    /// that wait for the interface.
    pub(super) fn tick(&self, now: Instant) -> Option<ForControl> {
        let mut driver = self.lock_for_control();
        driver.now = now;
        driver.change(&self.sets, |interface, context| interface.tick(context));
        driver.interface.take_for_control()
    }

    /// Asks for the first tick of an interface that was declared.
    pub(super) fn ask_for_tick(&self) -> Option<ForControl> {
        let mut driver = self.lock_for_control();
        driver.interface.ask_for_tick();
        driver.interface.take_for_control()
    }
}

impl GiveBack for SharedInterface {
    //= SM2-MSG-005
    fn give_back(&self, link: LinkToken, sequence: u64) {
        (self.lock()).change(|interface, context| interface.give_back(link, sequence, context));
    }
}

impl LockedInterface<'_> {
    /// Drives the links.
    pub(super) fn drive(&mut self) {
        let sets = &self.shared.sets;
        DerefMut::deref_mut(self).drive(sets);
    }

    /// Drives the links for a call that began at `now`.
    pub(super) fn drive_at(&mut self, now: Instant) {
        (self.now, self.last_drive) = (now, now);
        self.drive();
    }

    /// Settles the messages that came back, and changes the interface.
    #[inline]
    pub(crate) fn change<R>(
        &mut self,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        let sets = &self.shared.sets;
        DerefMut::deref_mut(self).change(sets, change)
    }

    /// Releases the lock, and then passes the results of the call to the control side.
    #[cold]
    fn unlock_and_handle(&mut self) {
        let results = (self.driver.as_mut()).and_then(|it| it.interface.take_for_control());
        // The order of locks: the node's lock is never taken under that of an interface.
        self.driver = None;
        if let Some(results) = results {
            let SharedInterface { id, control, .. } = self.shared;
            control.handle(*id, results);
        }
    }

    /// The same as [`change`](Self::change), but without settling first.
    #[inline]
    pub(crate) fn change_unharvested<R>(
        &mut self,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        let sets = &self.shared.sets;
        DerefMut::deref_mut(self).change_unharvested(sets, change)
    }
}

impl Deref for LockedInterface<'_> {
    type Target = InterfaceDriver;

    #[inline]
    fn deref(&self) -> &InterfaceDriver {
        self.driver.as_ref().expect("locked until it is dropped")
    }
}

impl DerefMut for LockedInterface<'_> {
    #[inline]
    fn deref_mut(&mut self) -> &mut InterfaceDriver {
        self.driver.as_mut().expect("locked until it is dropped")
    }
}

impl Drop for LockedInterface<'_> {
    #[inline]
    fn drop(&mut self) {
        if (self.driver.as_ref()).is_some_and(|it| it.interface.has_for_control()) {
            self.unlock_and_handle();
        }
    }
}

impl InterfaceDriver {
    #[inline]
    fn change<R>(
        &mut self,
        sets: &LinkSets,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        self.change_unharvested(sets, |interface, context| {
            interface.harvest(context);
            change(interface, context)
        })
    }

    #[inline]
    fn change_unharvested<R>(
        &mut self,
        sets: &LinkSets,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        let mut context = Context {
            sets,
            now: self.now,
            socket_read: false,
        };
        let result = change(&mut self.interface, &mut context);
        // The end of a link wakes every thread that waits, also one that spins.
        let has_event = self.interface.reports.events.take_fresh();
        if context.socket_read || has_event || self.interface.has_ended_links() {
            self.sleepers.wake();
        }
        result
    }

    pub(crate) fn interface(&self) -> &DeclaredInterface {
        &self.interface
    }

    /// Prepares the interface for a sleep until it has an event.
    pub(crate) fn park(&mut self) {
        self.interface.links.park();
    }

    /// Whether a call that began at `now` has to read sockets first. A system call for each message of a ring would
    /// cost more than the message.
    #[inline]
    fn needs(&self, drive: Drive, now: Instant) -> bool {
        let is_due = || now.0.saturating_sub(self.last_drive.0) >= SOCKETS_WAIT_NS;
        match drive {
            Drive::No => false,
            Drive::Yes => true,
            Drive::IfDue => is_due(),
            Drive::UnlessRings => is_due() || !self.has_rings_only(),
            Drive::UnlessRing(token) => {
                let link = self.interface.links.get(token);
                is_due() || link.is_none_or(LinkDriver::is_woken_by_socket)
            }
        }
    }

    /// Reads from the readable sockets of links, and writes to the writable ones. Does a bounded amount of work and
    /// does not wait.
    fn drive(&mut self, sets: &LinkSets) {
        self.short_of_memory = false;
        if let Err(error) = sets.calls.wait(&mut self.events, Some(Duration::ZERO)) {
            return self.not_ready(&error);
        }
        // Taken out, because each event changes the driver.
        let mut ready = mem::take(&mut self.ready);
        ready.extend(self.events.iter());
        put_ends_last(&mut ready);
        if !ready.is_empty() {
            self.change(sets, |_, _| ());
        }
        let mut ends = 0;
        while let Some(event) = ready.pop() {
            let token = LinkToken(event.token);
            let (is_short, has_ended) = self.change_unharvested(sets, |interface, context| {
                interface.on_event(token, event, context);
                let link = interface.links.get(token);
                let has_ended = link.is_none_or(|it| it.end().is_some());
                (link.is_some_and(LinkDriver::is_short_of_memory), has_ended)
            });
            ends += usize::from(has_ended);
            if ends == ENDS {
                // The set reports the others again.
                ready.clear();
            }
            if is_short {
                self.not_ready(&"no memory for a link");
            }
            self.sleepers.wake();
        }
        self.ready = ready;
    }

    /// Notes that a socket could not be used, although it was ready.
    //= SM2-TRN-013
    fn not_ready(&mut self, reason: &dyn Display) {
        self.short_of_memory = true;
        if let Some(count) = self.shortages.count(sm2_io::clock::now()) {
            let node = &self.node_name;
            tracing::warn!(%node, %reason, count, "cannot use a socket now: the node tries again");
        }
    }

    /// The words that the next messages of the links fill.
    pub(super) fn next_words(&self) -> NextWords {
        let links = self.interface.links.iter();
        NextWords::of(links.filter_map(LinkDriver::next_word))
    }

    /// Whether all messages come through rings and no link is opening, so that the sockets need to be read only from
    /// time to time.
    #[inline]
    pub(crate) fn has_rings_only(&self) -> bool {
        let interface = &self.interface;
        interface.links.count_open() > 0
            && (interface.links.iter()).all(|it| !it.is_woken_by_socket() || it.end().is_some())
    }
}
