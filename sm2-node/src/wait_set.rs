//! Waiting for any of many things.

mod deadlines;
mod ready;
mod sources;
mod waitable;
mod watches;

use std::io;
use std::os::fd::AsFd;
use std::thread;
use std::time::Duration;

use sm2_io::{Epoll, Events, is_shortage};
use sm2_proto::Instant;

use self::sources::{Kind, Sources};
pub(crate) use self::waitable::Source;
use self::watches::Watches;

pub use self::ready::{Cause, Interest, Key, Readiness, Ready};
pub use self::waitable::Waitable;
use crate::driver::{Condition, SHORTAGE_PAUSE, SharedNode, UndrivenControl, Until, WaitFailure};
use crate::{Node, Shutdown, Timer, WaitError, domain};

/// How many descriptors one system call reports.
const EVENTS: usize = 64;

/// Waits for any of many sources: [subscribers, servers, pending calls and events](Waitable), timers, and descriptors
/// of the program.
///
/// Each source has a tag of the program's choice, which tells the sources apart. With an enumeration, the compiler
/// checks that the program handles each of them:
///
/// ```no_run
/// use std::time::Duration;
/// use sm2_node::{Node, Shutdown, Timer, WaitError, WaitSet};
///
/// #[derive(Clone, Copy)]
/// enum Source {
///     Scan,
///     Tick,
/// }
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let node = Node::new("driver")?;
/// let scans = node.subscriber::<[f32]>("scan")?;
/// let commands = node.publisher::<f32>("speed")?;
/// let shutdown = Shutdown::new()?;
///
/// let mut set = WaitSet::new()?;
/// set.add(&scans, Source::Scan)?;
/// set.add_timer(Timer::hz(100), Source::Tick);
/// set.end_with(&shutdown)?;
/// let mut nearest = f32::INFINITY;
/// loop {
///     match set.wait() {
///         Ok(ready) => match ready.tag {
///             Source::Scan => {
///                 while let Some(scan) = scans.try_recv()? {
///                     nearest = scan.iter().copied().fold(f32::INFINITY, f32::min);
///                 }
///             }
///             Source::Tick => drop(commands.publish(&nearest.min(1.0))?),
///         },
///         Err(WaitError::Shutdown) => return Ok(()),
///         Err(error) => return Err(error.into()),
///     }
/// }
/// # }
/// ```
///
/// # When a source is ready
///
/// | source | reported | until |
/// | --- | --- | --- |
/// | subscriber, server, events, synchronizer | again and again | its `try_…` method finds nothing more |
/// | pending call | once, then the call leaves the set | |
/// | timer | once for each tick, or for all missed ticks ([`MissedTicks`](crate::MissedTicks)) | |
/// | [once](Timer::once) | once, then the timer leaves the set | |
/// | descriptor | again and again | it is not ready any more |
/// | changes of a domain | again and again | [`try_wait`](domain::Watch::try_wait) finds nothing more |
///
/// The sources that are ready at the same time are reported in turn. Between the report and the call of the program,
/// another thread may take the message: the `try_…` method then returns `None`. While the program holds as many
/// messages as `max_borrowed` allows, a subscriber with a further message is ready, and `try_recv` returns the error.
///
/// Sources can be added and removed at any time between two waits, also a source that is ready: it is not reported any
/// more. A subscriber, server, call or node may be dropped while it is in a set: it ends at once and is never ready
/// again. Some of its memory and descriptors are freed when it is removed from the set.
///
/// # Cost
///
/// A wait is one `epoll` call for any number of sources, and less than one if several are ready together. An event of
/// an interface costs the calls that read its sockets; all other interfaces cost nothing. An idle set does not wake up:
/// it has no interval of its own, and timers end the sleep at their deadlines, without descriptors. Once its buffers
/// have grown, a set allocates nothing, except for sources that are added. Threads that wait here always sleep: the
/// [`Wait`](crate::Wait) of an interface is for its own calls.
///
/// # Nodes without a background thread
///
/// While a thread waits in the set, it drives the nodes of all its sources that have no
/// [background thread](crate::NodeBuilder::background). [`drive`](Self::drive) adds a node without any source in the
/// set, such as one that only publishes.
///
/// # Threads
///
/// One thread uses a set at a time: a set is `Send`, and its methods need `&mut`. A [`Shutdown`] ends a wait from
/// another thread. After `fork(2)`, the child must not use its copy of the set, but may drop it.
#[derive(Debug)]
pub struct WaitSet<'fd, T> {
    epoll: Epoll,
    events: Events,
    sources: Sources<'fd, T>,
    watches: Watches,
    /// The newest token.
    last_token: u64,
}

impl<'fd, T: Clone> WaitSet<'fd, T> {
    /// Creates an empty set.
    ///
    /// # Errors
    ///
    /// Errors of `epoll_create1(2)`: too many descriptors, or no memory.
    pub fn new() -> io::Result<Self> {
        Ok(Self {
            epoll: Epoll::new()?,
            events: Events::with_capacity(EVENTS),
            sources: Sources::new(),
            watches: Watches::default(),
            last_token: 0,
        })
    }

    /// Adds a subscriber, a server, a pending call or events.
    ///
    /// # Errors
    ///
    /// Errors of `eventfd(2)` and `epoll_ctl(2)`: too many descriptors, or no memory.
    pub fn add(&mut self, source: &impl Waitable, tag: T) -> io::Result<Key> {
        let interface = source.interface();
        if let Some(control) = UndrivenControl::of_interface(interface) {
            let token = self.next_token();
            self.watches.drive(&self.epoll, control, false, token)?;
        }
        let (token, key) = (self.next_token(), self.next_key());
        let watch = (self.watches).add(&self.epoll, interface, token, key)?;
        let kind = Kind::Interface {
            watch,
            condition: source.condition(),
            deadline: source.deadline(),
        };
        self.sources.insert(key, tag, kind);
        Ok(key)
    }

    /// Adds a timer.
    pub fn add_timer(&mut self, timer: Timer, tag: T) -> Key {
        let key = self.next_key();
        self.sources.insert(key, tag, Kind::Timer(timer));
        key
    }

    /// Adds a descriptor of the program, level-triggered. The set keeps `fd` until [`remove`](Self::remove): pass a
    /// reference, which then stays borrowed as long as the set lives, or the value itself.
    ///
    /// # Errors
    ///
    /// Errors of `epoll_ctl(2)`, such as `AlreadyExists` for a descriptor that is in the set, and `PermissionDenied`
    /// for a regular file.
    pub fn add_descriptor(
        &mut self,
        fd: impl AsFd + Send + 'fd,
        interest: Interest,
        tag: T,
    ) -> io::Result<Key> {
        let key = self.next_key();
        self.epoll.add(fd.as_fd(), key.0, interest.into())?;
        let kind = Kind::Descriptor {
            fd: Box::new(fd),
            interest,
            readiness: Readiness::default(),
        };
        self.sources.insert(key, tag, kind);
        Ok(key)
    }

    /// Adds the changes of a domain, and [drives](Self::drive) the node of `watch`. The messages of that node do not
    /// wake the set.
    ///
    /// # Errors
    ///
    /// Errors of `eventfd(2)` and `epoll_ctl(2)`: too many descriptors, no memory, or `AlreadyExists` for a watch that
    /// is in the set.
    pub fn add_watch(&mut self, watch: &mut domain::Watch, tag: T) -> io::Result<Key> {
        let (node, bell) = watch.bell()?;
        self.drive_node(node)?;
        self.add_descriptor(bell, Interest::Readable, tag)
    }

    /// Ends every wait of the set when this shutdown is requested, also if a source is ready.
    ///
    /// # Errors
    ///
    /// Errors of `epoll_ctl(2)`: `AlreadyExists` if the set has the handle, or no memory.
    pub fn end_with(&mut self, shutdown: &Shutdown) -> io::Result<()> {
        let token = self.next_token();
        self.watches.end_with(&self.epoll, shutdown, token)
    }

    /// Drives a node without a background thread during every wait. The nodes of sources in the set are driven without
    /// this call, and nodes with a background thread need none.
    ///
    /// # Errors
    ///
    /// Errors of `epoll_ctl(2)`: no memory.
    pub fn drive(&mut self, node: &Node) -> io::Result<()> {
        self.drive_node(&node.shared)
    }

    fn drive_node(&mut self, node: &SharedNode) -> io::Result<()> {
        match UndrivenControl::of_node(node) {
            Some(control) => {
                let token = self.next_token();
                self.watches.drive(&self.epoll, control, true, token)
            }
            None => Ok(()),
        }
    }

    /// Removes a source. Returns whether it was in the set. It is not reported any more, even if it was ready.
    pub fn remove(&mut self, key: Key) -> bool {
        match self.sources.remove(key) {
            Some(Kind::Interface { watch, .. }) => self.watches.remove(&self.epoll, watch, key),
            Some(Kind::Descriptor { fd, .. }) => drop(self.epoll.remove(fd.as_fd())),
            Some(Kind::Timer(_)) => {}
            None => return false,
        }
        true
    }

    /// Stops reporting a source until [`resume`](Self::resume), because the program cannot handle it now. It costs no
    /// wake-ups meanwhile.
    pub(crate) fn suspend(&mut self, key: Key) {
        if let Some(Kind::Descriptor { fd, .. }) = self.sources.suspend(key, true) {
            let _ = self.epoll.remove(fd.as_fd());
        }
    }

    /// Reports a source again.
    pub(crate) fn resume(&mut self, key: Key) -> io::Result<()> {
        match self.sources.suspend(key, false) {
            Some(Kind::Descriptor { fd, interest, .. }) => {
                self.epoll.add(fd.as_fd(), key.0, (*interest).into())?;
            }
            Some(&Kind::Interface { watch, .. }) => self.watches.look_again(watch),
            Some(Kind::Timer(_)) | None => {}
        }
        Ok(())
    }

    /// Looks at a source with the `cause` that the set has reported. Returns why it is ready now: its state may have
    /// changed since. Only descriptors can change it: the others are asked for an item.
    pub(crate) fn confirm(&self, key: Key, cause: Cause) -> io::Result<Option<Cause>> {
        let Some(Kind::Descriptor { fd, interest, .. }) = self.sources.kind(key) else {
            return Ok(Some(cause));
        };
        let (readable, writable) = match sm2_io::poll_now(fd.as_fd(), (*interest).into()) {
            // The next wait reports it again.
            Err(error) if is_shortage(&error) => return Ok(None),
            ready => ready?,
        };
        let ready = Readiness { readable, writable };
        Ok((readable || writable).then_some(Cause::Descriptor(ready)))
    }

    /// Whether the set has this source.
    pub(crate) fn contains(&self, key: Key) -> bool {
        self.sources.kind(key).is_some()
    }

    /// The number of sources.
    #[must_use]
    pub fn len(&self) -> usize {
        self.sources.len()
    }

    /// Whether the set has no source.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Waits for the next source that is ready, without a time limit.
    ///
    /// # Errors
    ///
    /// [`WaitError::Shutdown`], [`WaitError::Io`].
    pub fn wait(&mut self) -> Result<Ready<T>, WaitError> {
        Ok(self.wait_or_fail()?)
    }

    pub(crate) fn wait_or_fail(&mut self) -> Result<Ready<T>, WaitFailure> {
        loop {
            if let Some(ready) = self.wait_until(Until::Forever)? {
                return Ok(ready);
            }
        }
    }

    /// Waits for the next source that is ready, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// As [`wait`](Self::wait).
    pub fn wait_timeout(&mut self, timeout: Duration) -> Result<Option<Ready<T>>, WaitError> {
        Ok(self.wait_until(Until::In(timeout))?)
    }

    /// Returns the next source that is ready, if there is one, also after a shutdown.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn try_wait(&mut self) -> Result<Option<Ready<T>>, WaitError> {
        Ok(self.wait_until(Until::NOW)?)
    }

    pub(crate) fn wait_until(&mut self, until: Until) -> Result<Option<Ready<T>>, WaitFailure> {
        let mut now = sm2_io::clock::now();
        let until_moment = until.moment(now);
        loop {
            if until.waits() && self.watches.is_shut_down() {
                return Err(WaitFailure::Shutdown);
            }
            if let Some(ready) = self.next_ready() {
                return Ok(Some(ready));
            }
            self.collect(now, until_moment)?;
            now = sm2_io::clock::now();
            self.sources.expire(now);
            if !self.sources.has_ready() && until_moment.is_some_and(|until| until <= now) {
                return Ok(None);
            }
        }
    }

    /// Takes the next source out of the queue.
    fn next_ready(&mut self) -> Option<Ready<T>> {
        let ready = self.sources.next(sm2_io::clock::now)?;
        match self.sources.kind(ready.key) {
            Some(&Kind::Interface {
                watch,
                condition: Condition::Call(_),
                ..
            }) => {
                self.watches.look_again(watch);
                self.remove(ready.key);
            }
            // The program is about to take something, and there may be more.
            Some(&Kind::Interface { watch, .. }) => self.watches.look_again(watch),
            Some(Kind::Timer(timer)) if timer.deadline().is_none() => drop(self.remove(ready.key)),
            _ => {}
        }
        Some(ready)
    }

    /// Finds the sources that are ready. If there is none, sleeps until a descriptor has an event, a deadline has
    /// passed, or `until`.
    fn collect(&mut self, now: Instant, until: Option<Instant>) -> io::Result<()> {
        let sources = &mut self.sources;
        self.watches.look(sources);
        sources.expire(now);
        let end = match (until, sources.deadline()) {
            _ if sources.has_ready() => Some(now),
            (Some(until), Some(deadline)) => Some(until.min(deadline)),
            (until, deadline) => until.or(deadline),
        };
        let timeout = end.map(|end| end.since(now));
        let pause = timeout.map_or(SHORTAGE_PAUSE, |it| it.min(SHORTAGE_PAUSE));
        match self.epoll.wait(&mut self.events, timeout) {
            Ok(()) => {}
            Err(error) if is_shortage(&error) => {
                thread::sleep(pause);
                return Ok(());
            }
            Err(error) => return Err(error),
        }
        let mut short_of_memory = false;
        for event in self.events.iter() {
            sources.descriptor_ready(Key(event.token), event);
            short_of_memory |= self.watches.handle(event.token, sources);
        }
        //= SM2-TRN-013
        if short_of_memory && !sources.has_ready() {
            thread::sleep(pause);
        }
        Ok(())
    }

    fn next_key(&mut self) -> Key {
        Key(self.next_token())
    }

    fn next_token(&mut self) -> u64 {
        self.last_token += 1;
        self.last_token
    }
}
