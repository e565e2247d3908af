//! The state of a group, and which of its callbacks runs.

use std::mem;
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::id::CallbackId;
use crate::wait_set::{Cause, Key};

/// The state that the callbacks of a group share, and their turn.
pub(super) struct GroupState<S> {
    pub(super) turn: Turn,
    state: Mutex<S>,
}

impl<S> GroupState<S> {
    pub(super) fn new(state: S) -> Self {
        Self {
            turn: Turn::default(),
            state: Mutex::new(state),
        }
    }

    /// Locks the state. A callback that panicked may have left it half changed, as the documentation says.
    pub(super) fn lock(&self) -> MutexGuard<'_, S> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The turn of a group: at most one of its callbacks runs at a time. The others wait here for the end of that one.
#[derive(Debug, Default)]
pub(super) struct Turn(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    is_taken: bool,
    waiting: Vec<Due>,
}

/// A callback whose source is ready.
#[derive(Clone, Copy, Debug)]
pub(super) struct Due {
    pub(super) id: CallbackId,
    pub(super) key: Key,
    pub(super) cause: Cause,
}

impl Turn {
    /// Takes the turn for a callback that is due. If another one has it, the callback waits, and `false` is returned.
    pub(super) fn take_or_wait(&self, due: Due) -> bool {
        let mut state = self.lock();
        if state.is_taken {
            state.waiting.push(due);
            return false;
        }
        state.is_taken = true;
        true
    }

    /// Gives the turn back. Returns the callbacks that have waited for it, in order.
    pub(super) fn give_back(&self) -> Vec<Due> {
        let mut state = self.lock();
        state.is_taken = false;
        mem::take(&mut state.waiting)
    }

    /// No code that can panic runs under the lock.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
