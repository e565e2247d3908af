//! The numbers of an interface that concern messages between two links.

use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};

use sm2_proto::Contract;
use sm2_proto::link::Absences;

/// The knowledge of an interface about publications while a publisher and a subscriber have no link.
#[derive(Debug)]
pub(super) struct Absence {
    /// A publisher's number, which it says in OPEN. 0 at all other interfaces.
    pub(super) publisher: u64,
    /// A subscriber's publishers without a link.
    pub(super) publishers: Absences,
}

impl Absence {
    pub(super) fn of(contract: &Contract) -> Self {
        let publisher = match contract {
            // Each `RandomState` has other keys, so its hash of nothing is a random number.
            Contract::Publisher { .. } => RandomState::new().build_hasher().finish().max(1),
            _ => 0,
        };
        Self {
            publisher,
            publishers: Absences::default(),
        }
    }
}
