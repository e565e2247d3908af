//! The tasks of an executor.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::callback::Failure;
use super::origin::Origin;
use super::turn::{GroupState, Turn};
use crate::params::{Change, Changes};
use crate::wait_set::{Cause, Readiness};
use crate::{
    Call, CallError, Event, Events, Message, RecvError, Reply, Request, Sample, Server, Subscriber,
    Synchronizer, Tick,
};

/// A source together with its callback. Both steps are made by the thread that has the turn of the group.
pub(super) trait Task: Send + Sync {
    /// The turn of its group.
    fn turn(&self) -> &Turn;

    /// The name of the callback.
    fn origin(&self) -> &Origin;

    /// Takes the item that the callback runs for. Returns whether there was one.
    fn take(&self, cause: Cause) -> bool;

    /// Runs the callback with the item.
    fn run(&self) -> Result<(), Failure>;
}

/// A source of items for a callback.
pub(super) trait Supply: Send {
    type Item: Send;

    fn take(&mut self, cause: Cause) -> Option<Self::Item>;
}

/// A task of a group with the state `S`.
pub(super) struct SupplyTask<S, P: Supply, F> {
    group: Arc<GroupState<S>>,
    origin: Origin,
    work: Mutex<Work<P, F>>,
}

struct Work<P: Supply, F> {
    supply: P,
    item: Option<P::Item>,
    callback: F,
}

impl<S, P: Supply, F> SupplyTask<S, P, F> {
    pub(super) const fn new(
        group: Arc<GroupState<S>>,
        origin: Origin,
        supply: P,
        callback: F,
    ) -> Self {
        let work = Mutex::new(Work {
            supply,
            item: None,
            callback,
        });
        Self {
            group,
            origin,
            work,
        }
    }

    /// Never contended: only the thread with the turn uses it.
    fn work(&self) -> MutexGuard<'_, Work<P, F>> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<S, P, F> Task for SupplyTask<S, P, F>
where
    S: Send,
    P: Supply,
    F: FnMut(&mut S, P::Item) -> Result<(), Failure> + Send,
{
    fn turn(&self) -> &Turn {
        &self.group.turn
    }

    fn origin(&self) -> &Origin {
        &self.origin
    }

    fn take(&self, cause: Cause) -> bool {
        let mut work = self.work();
        work.item = work.supply.take(cause);
        work.item.is_some()
    }

    fn run(&self) -> Result<(), Failure> {
        let mut work = self.work();
        let item = work.item.take();
        let mut state = self.group.lock();
        item.map_or(Ok(()), |item| (work.callback)(&mut state, item))
    }
}

impl<T: Message + ?Sized> Supply for Subscriber<T> {
    type Item = Result<Sample<T>, RecvError>;

    fn take(&mut self, _: Cause) -> Option<Self::Item> {
        self.try_recv().transpose()
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Supply for Server<Q, R> {
    type Item = Result<Request<Q, R>, RecvError>;

    fn take(&mut self, _: Cause) -> Option<Self::Item> {
        self.try_recv().transpose()
    }
}

impl<R: Message + ?Sized> Supply for Call<R> {
    type Item = Result<Reply<R>, CallError>;

    fn take(&mut self, _: Cause) -> Option<Self::Item> {
        self.try_wait().transpose()
    }
}

impl Supply for Events {
    type Item = Event;

    fn take(&mut self, _: Cause) -> Option<Event> {
        self.pop()
    }
}

impl Supply for Changes {
    type Item = Result<Change, RecvError>;

    fn take(&mut self, _: Cause) -> Option<Self::Item> {
        self.try_next().transpose()
    }
}

impl<S: Send + 'static> Supply for Synchronizer<S> {
    type Item = Result<S, RecvError>;

    fn take(&mut self, _: Cause) -> Option<Self::Item> {
        self.try_recv().transpose()
    }
}

/// The ticks of a timer.
pub(super) struct Ticks;

impl Supply for Ticks {
    type Item = Tick;

    fn take(&mut self, cause: Cause) -> Option<Tick> {
        match cause {
            Cause::Tick(tick) => Some(tick),
            Cause::Interface | Cause::Descriptor(_) => None,
        }
    }
}

/// The readiness of a descriptor.
pub(super) struct Readinesses;

impl Supply for Readinesses {
    type Item = Readiness;

    fn take(&mut self, cause: Cause) -> Option<Readiness> {
        match cause {
            Cause::Descriptor(readiness) => Some(readiness),
            Cause::Interface | Cause::Tick(_) => None,
        }
    }
}
