//! The sources of a wait set, and which of them are ready.

use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::os::fd::AsFd;

use sm2_proto::Instant;

use super::deadlines::Deadlines;
use super::{Cause, Interest, Key, Readiness, Ready};
use crate::Timer;
use crate::driver::{Condition, Context, DeclaredInterface};

/// The sources of a wait set. A source that is ready is in the queue, once.
#[derive(Debug)]
pub(super) struct Sources<'fd, T> {
    all: HashMap<Key, Source<'fd, T>>,
    deadlines: Deadlines,
    queue: VecDeque<Key>,
}

#[derive(Debug)]
struct Source<'fd, T> {
    tag: T,
    kind: Kind<'fd>,
    is_queued: bool,
    /// Not reported for now.
    is_suspended: bool,
}

/// A source of the program or of a node.
pub(super) enum Kind<'fd> {
    /// An interface, watched under this token.
    Interface {
        watch: u64,
        condition: Condition,
        deadline: Option<Instant>,
    },
    Timer(Timer),
    Descriptor {
        fd: Box<dyn AsFd + Send + 'fd>,
        interest: Interest,
        /// The newest event.
        readiness: Readiness,
    },
}

impl Kind<'_> {
    fn deadline(&self) -> Option<Instant> {
        match self {
            Self::Interface { deadline, .. } => *deadline,
            Self::Timer(timer) => timer.deadline(),
            Self::Descriptor { .. } => None,
        }
    }
}

impl<'fd, T> Sources<'fd, T> {
    pub(super) fn new() -> Self {
        Self {
            all: HashMap::new(),
            deadlines: Deadlines::default(),
            queue: VecDeque::new(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.all.len()
    }

    pub(super) fn insert(&mut self, key: Key, tag: T, kind: Kind<'fd>) {
        if let Some(at) = kind.deadline() {
            self.deadlines.insert(at, key);
        }
        let source = Source {
            tag,
            kind,
            is_queued: false,
            is_suspended: false,
        };
        self.all.insert(key, source);
    }

    pub(super) fn remove(&mut self, key: Key) -> Option<Kind<'fd>> {
        let source = self.all.remove(&key)?;
        if let Some(at) = source.kind.deadline() {
            self.deadlines.remove(at, key);
        }
        Some(source.kind)
    }

    pub(super) fn kind(&self, key: Key) -> Option<&Kind<'fd>> {
        self.all.get(&key).map(|source| &source.kind)
    }

    /// Stops reporting a source, or reports it again. Returns whether the set has it, and that is a change.
    pub(super) fn suspend(&mut self, key: Key, suspend: bool) -> Option<&Kind<'fd>> {
        let source = self.all.get_mut(&key)?;
        if source.is_suspended == suspend {
            return None;
        }
        source.is_suspended = suspend;
        if let Some(at) = source.kind.deadline() {
            match suspend {
                true => self.deadlines.remove(at, key),
                false => self.deadlines.insert(at, key),
            }
        }
        Some(&source.kind)
    }

    /// Looks for what the sources of an interface wait for. Returns whether all of them have found something.
    pub(super) fn look(
        &mut self,
        keys: &[Key],
        interface: &mut DeclaredInterface,
        context: &mut Context<'_>,
    ) -> bool {
        let mut found_all = true;
        for &key in keys {
            let Some(source) = self.all.get_mut(&key) else {
                continue;
            };
            // A suspended source is looked at when it is resumed.
            if source.is_queued || source.is_suspended {
                continue;
            }
            let Kind::Interface { condition, .. } = source.kind else {
                continue;
            };
            if interface.is_ready(condition, context) {
                source.is_queued = true;
                self.queue.push_back(key);
            } else {
                found_all = false;
            }
        }
        found_all
    }

    /// Notes an event of a descriptor.
    pub(super) fn descriptor_ready(&mut self, key: Key, event: sm2_io::Event) {
        let Some(source) = self.all.get_mut(&key) else {
            return;
        };
        if let Kind::Descriptor { readiness, .. } = &mut source.kind {
            *readiness = Readiness {
                readable: event.readable,
                writable: event.writable,
            };
            self.enqueue(key);
        }
    }

    /// The sources whose deadline has passed are ready.
    pub(super) fn expire(&mut self, now: Instant) {
        while let Some(key) = self.deadlines.pop_passed(now) {
            self.enqueue(key);
        }
    }

    fn enqueue(&mut self, key: Key) {
        if let Some(source) = self.all.get_mut(&key)
            && !source.is_queued
        {
            source.is_queued = true;
            self.queue.push_back(key);
        }
    }

    pub(super) fn has_ready(&self) -> bool {
        !self.queue.is_empty()
    }

    /// The time when a source becomes ready by itself.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.deadlines.first()
    }
}

impl<T: Clone> Sources<'_, T> {
    /// Takes the next source that is ready. The time is that of the call.
    pub(super) fn next(&mut self, now: impl Fn() -> Instant) -> Option<Ready<T>> {
        loop {
            let key = self.queue.pop_front()?;
            // It may have been removed meanwhile.
            let Some(source) = self.all.get_mut(&key) else {
                continue;
            };
            source.is_queued = false;
            let cause = match &mut source.kind {
                Kind::Interface { .. } => Cause::Interface,
                Kind::Descriptor { readiness, .. } => Cause::Descriptor(*readiness),
                Kind::Timer(timer) => {
                    let tick = timer.handle(now());
                    if let Some(next) = timer.deadline() {
                        self.deadlines.insert(next, key);
                    }
                    match tick {
                        Some(tick) => Cause::Tick(tick),
                        None => continue,
                    }
                }
            };
            let tag = source.tag.clone();
            return Some(Ready { tag, key, cause });
        }
    }
}

impl fmt::Debug for Kind<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Interface { condition, .. } => {
                f.debug_tuple("Interface").field(condition).finish()
            }
            Self::Timer(timer) => f.debug_tuple("Timer").field(timer).finish(),
            Self::Descriptor { fd, .. } => f.debug_tuple("Descriptor").field(&fd.as_fd()).finish(),
        }
    }
}
