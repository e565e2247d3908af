//! The latest changes of the domain: one key for each revision.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::VecDeque;

use crate::control::Key;

/// Each change has a revision of its own, so revision and changes cannot disagree.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Log {
    revision: u64,
    /// The latest changes; the last of them led to `revision`.
    changed: VecDeque<Key>,
    limit: usize,
}

impl Log {
    pub(super) const fn new(limit: usize) -> Self {
        Self {
            revision: 0,
            changed: VecDeque::new(),
            limit,
        }
    }

    pub(super) const fn revision(&self) -> u64 {
        self.revision
    }

    pub(super) fn push(&mut self, key: Key) {
        self.revision += 1;
        self.changed.push_back(key);
        if self.changed.len() > self.limit {
            self.changed.pop_front();
        }
    }

    /// Forgets all changes, because each session may see other items from now on.
    //= SM2-ACC-013
    pub(super) fn forget(&mut self) {
        self.revision += 1;
        self.changed.clear();
    }

    /// The changes after a revision, each with the revision that it led to. `None` if some of them
    /// are forgotten, or if there was no such revision.
    pub(super) fn since(&self, after: u64) -> Option<impl Iterator<Item = (u64, Key)>> {
        let count = usize::try_from(self.revision.checked_sub(after)?).ok()?;
        let skipped = self.changed.len().checked_sub(count)?;
        let changed = self.changed.range(skipped..).copied();
        Some((after + 1..).zip(changed))
    }
}
