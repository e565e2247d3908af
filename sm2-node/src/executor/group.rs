//! Groups of callbacks that exclude each other.

use std::fmt;
use std::io;
use std::os::fd::AsFd;
use std::panic::Location;
use std::sync::Arc;

use super::callback::{ExecutorError, Failure};
use super::id::CallbackId;
use super::mailbox::Mailbox;
use super::origin::{CallbackSource, Origin};
use super::runs::{Duties, GroupKey};
use super::task::{Readinesses, Supply, SupplyTask, Ticks};
use super::tasks::{Addition, Tasks};
use super::turn::GroupState;
use crate::params::{Change, Changes};
use crate::wait_set::{Interest, Key, Readiness, Waitable};
use crate::{
    Call, CallError, Event, Events, Message, RecvError, Reply, Request, Sample, Server, Subscriber,
    Synchronizer, Tick, Timer, WaitSet,
};

/// A group of callbacks that exclude each other, with the state that they share.
///
/// At most one callback of a group runs at a time, so each gets the state as `&mut S`. Callbacks of different groups
/// run at the same time in an executor with several [threads](super::Executor::run_threads).
///
/// Clones are handles of the same group. A callback may have a clone, of its own group or of another one, to add and
/// remove callbacks while the executor runs.
pub struct Group<'a, S> {
    state: Arc<GroupState<S>>,
    mailbox: Arc<Mailbox<Addition<'a>>>,
    duties: Arc<Duties>,
}

impl<'a, S: Send + 'a> Group<'a, S> {
    pub(super) fn new(
        state: S,
        mailbox: &Arc<Mailbox<Addition<'a>>>,
        duties: &Arc<Duties>,
    ) -> Self {
        Self {
            state: Arc::new(GroupState::new(state)),
            mailbox: Arc::clone(mailbox),
            duties: Arc::clone(duties),
        }
    }

    /// Gives access to the state, also while the executor does not run. Waits for the end of a callback that runs, so a
    /// callback must not call this for its own group.
    pub fn with<R>(&self, access: impl FnOnce(&mut S) -> R) -> R {
        access(&mut self.state.lock())
    }

    /// Runs `callback` for each message of a subscriber, or with the error if a message cannot be read.
    #[track_caller]
    pub fn on_message<T, F>(&self, subscriber: Subscriber<T>, callback: F) -> CallbackId
    where
        T: Message + ?Sized,
        F: FnMut(&mut S, Result<Sample<T>, RecvError>) -> Result<(), Failure> + Send + 'a,
    {
        self.add_source(subscriber, callback)
    }

    /// Runs `callback` for each request of a server, or with the error if a request cannot be read.
    #[track_caller]
    pub fn on_request<Q, R, F>(&self, server: Server<Q, R>, callback: F) -> CallbackId
    where
        Q: Message + ?Sized,
        R: Message + ?Sized,
        F: FnMut(&mut S, Result<Request<Q, R>, RecvError>) -> Result<(), Failure> + Send + 'a,
    {
        self.add_source(server, callback)
    }

    /// Runs `callback` once, with the reply to a call or the reason why there is none. [Removing](Self::remove) the
    /// callback cancels the call.
    #[track_caller]
    pub fn on_reply<R, F>(&self, call: Call<R>, callback: F) -> CallbackId
    where
        R: Message + ?Sized,
        F: FnOnce(&mut S, Result<Reply<R>, CallError>) -> Result<(), Failure> + Send + 'a,
    {
        let mut callback = Some(callback);
        self.add_source(call, move |state: &mut S, reply| {
            (callback.take()).map_or(Ok(()), |callback| callback(state, reply))
        })
    }

    /// Runs `callback` for each event of a publisher, subscriber, server or client.
    #[track_caller]
    pub fn on_event<F>(&self, events: Events, callback: F) -> CallbackId
    where
        F: FnMut(&mut S, Event) -> Result<(), Failure> + Send + 'a,
    {
        self.add_source(events, callback)
    }

    /// Runs `callback` for each change of parameters that another node asks for, or with the error if it cannot be
    /// received.
    #[track_caller]
    pub fn on_change<F>(&self, changes: Changes, callback: F) -> CallbackId
    where
        F: FnMut(&mut S, Result<Change, RecvError>) -> Result<(), Failure> + Send + 'a,
    {
        self.add_source(changes, callback)
    }

    /// Runs `callback` for each set of a synchronizer, or with the error if a message cannot be read.
    #[track_caller]
    pub fn on_set<T, F>(&self, synchronizer: Synchronizer<T>, callback: F) -> CallbackId
    where
        T: Send + 'static,
        F: FnMut(&mut S, Result<T, RecvError>) -> Result<(), Failure> + Send + 'a,
    {
        let topics = synchronizer.topics();
        let source = CallbackSource::Synchronizer { topics };
        self.add(source, synchronizer, callback, |set, synchronizer, id| {
            set.add_synchronizer(synchronizer, Some(id))
        })
    }

    /// Runs `callback` for each tick of a timer.
    #[track_caller]
    pub fn on_tick<F>(&self, timer: Timer, callback: F) -> CallbackId
    where
        F: FnMut(&mut S, Tick) -> Result<(), Failure> + Send + 'a,
    {
        let register =
            |set: &mut WaitSet<'a, _>, _: &mut _, id| Ok(vec![set.add_timer(timer, Some(id))]);
        self.add(CallbackSource::Timer, Ticks, callback, register)
    }

    /// Runs `callback` while a descriptor is ready: see [`WaitSet::add_descriptor`]. The descriptor is ready when the
    /// callback starts, also if another callback of this group or another thread of the executor has just read from it.
    #[track_caller]
    pub fn on_ready<F>(
        &self,
        fd: impl AsFd + Send + 'a,
        interest: Interest,
        callback: F,
    ) -> CallbackId
    where
        F: FnMut(&mut S, Readiness) -> Result<(), Failure> + Send + 'a,
    {
        let register = move |set: &mut WaitSet<'a, _>, _: &mut _, id| {
            Ok(vec![set.add_descriptor(fd, interest, Some(id))?])
        };
        self.add(CallbackSource::Descriptor, Readinesses, callback, register)
    }

    /// Removes a callback of any group of the executor, and drops its source. A callback that runs comes to its end.
    pub fn remove(&self, callback: CallbackId) {
        self.mailbox
            .leave(|letters| letters.removals.push(callback));
    }

    #[track_caller]
    fn add_source<P, F>(&self, supply: P, callback: F) -> CallbackId
    where
        P: Supply + Waitable + 'a,
        F: FnMut(&mut S, P::Item) -> Result<(), Failure> + Send + 'a,
    {
        let source = CallbackSource::of(&supply);
        let (interface, group) = (
            Arc::clone(supply.interface()),
            GroupKey::of(&self.state.turn),
        );
        let id = self.mailbox.next_id();
        self.duties.add(id, group, &interface);
        self.add_as(id, source, supply, callback, |set, supply, id| {
            Ok(vec![set.add(supply, Some(id))?])
        });
        id
    }

    #[track_caller]
    fn add<P, F, A>(
        &self,
        source: CallbackSource,
        supply: P,
        callback: F,
        register: A,
    ) -> CallbackId
    where
        P: Supply + 'a,
        F: FnMut(&mut S, P::Item) -> Result<(), Failure> + Send + 'a,
        A: FnOnce(&mut WaitSet<'a, Option<CallbackId>>, &mut P, CallbackId) -> io::Result<Vec<Key>>
            + Send
            + 'a,
    {
        let id = self.mailbox.next_id();
        self.add_as(id, source, supply, callback, register);
        id
    }

    /// The thread that waits registers the source, because it has the wait set.
    #[track_caller]
    fn add_as<P, F, A>(
        &self,
        id: CallbackId,
        source: CallbackSource,
        mut supply: P,
        callback: F,
        register: A,
    ) where
        P: Supply + 'a,
        F: FnMut(&mut S, P::Item) -> Result<(), Failure> + Send + 'a,
        A: FnOnce(&mut WaitSet<'a, Option<CallbackId>>, &mut P, CallbackId) -> io::Result<Vec<Key>>
            + Send
            + 'a,
    {
        let origin = Origin::new(source, Location::caller());
        let group = Arc::clone(&self.state);
        let add = move |tasks: &mut Tasks<'a>| match register(&mut tasks.set, &mut supply, id) {
            Ok(keys) => {
                let task = Arc::new(SupplyTask::new(group, origin, supply, callback));
                tasks.insert(id, keys, task);
                Ok(())
            }
            Err(error) => Err(ExecutorError::Source { origin, error }),
        };
        let addition = Addition::new(add);
        (self.mailbox).leave(|letters| letters.additions.push(addition));
    }
}

impl<S> Clone for Group<'_, S> {
    fn clone(&self) -> Self {
        Self {
            state: Arc::clone(&self.state),
            mailbox: Arc::clone(&self.mailbox),
            duties: Arc::clone(&self.duties),
        }
    }
}

impl<S> fmt::Debug for Group<'_, S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Group")
            .field("turn", &self.state.turn)
            .finish_non_exhaustive()
    }
}
