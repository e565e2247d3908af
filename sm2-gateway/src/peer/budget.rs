//! The memory of all connections together.
//!
//! A payload counts against the peer's memory as its bytes arrive, not by the length that its header announces.

use std::sync::Arc;

/// The memory that the connections of a gateway share. Each has an equal part, so that no peer
/// takes the memory of another one.
#[derive(Clone, Debug)]
pub struct Budget(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    max_bytes: u64,
    /// Each member has a reference.
    members: Arc<()>,
}

/// A connection that has a part of a [`Budget`], until it is dropped.
#[derive(Debug)]
pub struct Member {
    budget: Budget,
    _counted: Arc<()>,
}

impl Budget {
    /// A budget of `max_bytes` for all members together.
    #[must_use]
    pub fn new(max_bytes: u64) -> Self {
        let members = Arc::new(());
        Self(Arc::new(Shared { max_bytes, members }))
    }

    /// Adds a member. The parts of the others become smaller.
    #[must_use]
    pub fn join(&self) -> Member {
        Member {
            budget: self.clone(),
            _counted: Arc::clone(&self.0.members),
        }
    }
}

impl Member {
    /// The part of this member at present.
    #[must_use]
    pub fn part_bytes(&self) -> u64 {
        let Shared { max_bytes, members } = &*self.budget.0;
        // One reference is that of the budget.
        let members = Arc::strong_count(members) as u64 - 1;
        max_bytes / members.max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_have_equal_parts() {
        let budget = Budget::new(120);
        let first = budget.join();
        assert_eq!(first.part_bytes(), 120);
        let others = [budget.join(), budget.clone().join()];
        assert_eq!(first.part_bytes(), 40);
        drop(others);
        assert_eq!(first.part_bytes(), 120);
    }
}
