//! The callbacks that a thread runs, and the interfaces that cannot be served meanwhile.
//!
//! A callback that calls a service of its own executor and waits for the reply would wait for ever: the request is
//! taken only after the callback has ended. The thread therefore knows the callbacks that it runs, and each executor
//! knows the interfaces of its callbacks. A call that is about to wait compares the two ends of its link with them.

use std::cell::RefCell;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use sm2_proto::Instant;

use super::id::CallbackId;
use super::turn::Turn;
use crate::driver::{LinkEnds, LinkToken, SharedInterface};

thread_local! {
    /// The callbacks that this thread runs. There are several if a callback runs another executor.
    static ACTIVE: RefCell<Vec<Active>> = const { RefCell::new(Vec::new()) };
}

/// A callback that runs.
struct Active {
    began: Instant,
    group: GroupKey,
    duties: Arc<Duties>,
}

/// Tells groups apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct GroupKey(usize);

impl GroupKey {
    pub(super) fn of(turn: &Turn) -> Self {
        Self(std::ptr::from_ref(turn).addr())
    }
}

/// The interfaces that the callbacks of an executor take from.
#[derive(Debug, Default)]
pub(super) struct Duties(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    all: Vec<Duty>,
    /// The number of threads that run callbacks.
    threads: usize,
}

#[derive(Debug)]
struct Duty {
    callback: CallbackId,
    group: GroupKey,
    interface: Weak<SharedInterface>,
}

impl Duties {
    pub(super) fn add(
        &self,
        callback: CallbackId,
        group: GroupKey,
        interface: &Arc<SharedInterface>,
    ) {
        self.lock().all.push(Duty {
            callback,
            group,
            interface: Arc::downgrade(interface),
        });
    }

    pub(super) fn remove(&self, callback: CallbackId) {
        self.lock().all.retain(|it| it.callback != callback);
    }

    pub(super) fn set_threads(&self, threads: usize) {
        self.lock().threads = threads;
    }

    /// Whether a callback of this executor serves the link, and cannot run before one of `group` has ended.
    fn blocks(&self, link: &LinkEnds, group: GroupKey) -> bool {
        let state = self.lock();
        state.all.iter().any(|duty| {
            (state.threads <= 1 || duty.group == group)
                && (duty.interface.upgrade()).is_some_and(|it| it.is_receiving_end(link))
        })
    }

    /// No code that can panic runs under the lock.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Marks that this thread runs a callback, until it is dropped.
#[derive(Debug)]
pub(super) struct Run(());

impl Run {
    pub(super) fn begin(group: GroupKey, duties: &Arc<Duties>) -> Self {
        let active = Active {
            began: sm2_io::clock::now(),
            group,
            duties: Arc::clone(duties),
        };
        ACTIVE.with_borrow_mut(|all| all.push(active));
        Self(())
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let ended = ACTIVE.with_borrow_mut(Vec::pop);
        // Not inside of the borrow: it may be the last handle of an executor.
        drop(ended);
    }
}

/// Whether a call that the program began to send at this time waits for a callback that cannot run before the present
/// one of this thread has ended. A call that was sent before that one began may have been taken by its server already,
/// which may reply from another thread.
pub(crate) fn waits_for_itself(client: &SharedInterface, link: LinkToken, began: Instant) -> bool {
    let waits = ACTIVE.try_with(|all| {
        let all = all.borrow();
        let mut runs = all.iter().filter(|it| it.began < began).peekable();
        // Most threads run no callback.
        if runs.peek().is_none() {
            return false;
        }
        let Some(ends) = client.link_ends(link) else {
            return false;
        };
        runs.any(|it| it.duties.blocks(&ends, it.group))
    });
    waits.unwrap_or(false)
}
