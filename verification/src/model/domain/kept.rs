//! Machines together with the tape of their present state.

use std::cell::OnceCell;

use sm2_proto::manager::Manager;

use super::tape::{Keys, Tape};

/// The tape of a value, as long as the value does not change.
#[derive(Debug, Default)]
pub(super) struct Taped(OnceCell<Tape>);

/// A copy is made to be changed, so it has no tape.
impl Clone for Taped {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Taped {
    pub(super) fn forget(&mut self) {
        self.0.take();
    }

    pub(super) fn tape(&self, take: impl FnOnce() -> Tape) -> &Tape {
        self.0.get_or_init(take)
    }
}

/// A Manager and its tape.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    machine: Manager,
    taped: Taped,
}

impl Kept {
    pub(super) const fn new(machine: Manager) -> Self {
        Self {
            machine,
            taped: Taped(OnceCell::new()),
        }
    }

    pub(super) const fn machine(&self) -> &Manager {
        &self.machine
    }

    pub(super) fn machine_mut(&mut self) -> &mut Manager {
        self.taped.forget();
        &mut self.machine
    }

    pub(super) fn tape(&self, keys: &Keys) -> &Tape {
        self.taped.tape(|| Tape::of_manager(keys, &self.machine))
    }
}
