//! Harnesses for the log of changes, from any revision.

use super::{Key, Log};
use crate::{
    EntityId, NodeId,
    proofs::{below, one_of},
};

fn key(revision: u64) -> Key {
    let entity = EntityId::node(NodeId(revision));
    Key::Member { entity }
}

/// All changes after a revision are listed, each with its own revision. None are listed if one of
/// them is forgotten, or if the domain never had that revision.
//= SM2-WCH-002, SM2-IFC-007 kani
// Shows MGR-MIRROR (Exhaustive), bound: one step from any log of up to 3 changes, at revisions up to 2^64 - 3.
#[cfg_attr(kani, kani::proof)]
// At most three changes are remembered.
#[cfg_attr(kani, kani::unwind(6))]
fn the_log_tells_all_or_nothing() {
    let limit = below(4);
    // No domain changes 2^64 times.
    let revision = one_of(&[0, 1, 2, 3, 1 << 32, u64::MAX - 3]);
    let remembered = below(limit + 1);
    kani::assume(remembered as u64 <= revision);
    let mut log = Log::new(limit);
    log.revision = revision;
    for back in (0..remembered as u64).rev() {
        log.changed.push_back(key(revision - back));
    }
    let pushed = kani::any();
    if pushed {
        log.push(key(revision + 1));
    }
    let now = revision + u64::from(pushed);
    assert_eq!(log.revision(), now);
    let remembered = limit.min(remembered + usize::from(pushed)) as u64;
    assert_eq!(log.changed.len() as u64, remembered);
    let after = if kani::any() {
        now.saturating_add(below(2) as u64)
    } else {
        let back = below(5) as u64;
        kani::assume(back <= now);
        now - back
    };
    let told = after <= now && now - after <= remembered;
    let changes = log.since(after);
    assert_eq!(changes.is_some(), told);
    if let Some(changes) = changes {
        let expected = (0..now - after).map(|at| (after + 1 + at, key(after + 1 + at)));
        assert!(expected.eq(changes));
    }
    kani::cover!(told && now - after == 3, "three changes");
    kani::cover!(!told && after < now, "one is forgotten");
    kani::cover!(after > now, "no such revision");
}

#[cfg(test)]
kani::explored! {
    the_log_tells_all_or_nothing: 3,
}
