//! Harnesses for the unlinked pairs: one step from any state of four pairs.

use alloc::vec::Vec;

use super::{EntityId, NodeId, Pair, UnlinkedPairs, UnlinkedReason, pair};
use crate::{
    Code, InterfaceId,
    proofs::{below, one_of},
};

const fn entity(node: u64) -> EntityId {
    EntityId {
        node: NodeId(node),
        interface: InterfaceId(1),
    }
}

/// Two nodes that offer, and two that demand; one node does both.
const PAIRS: [Pair; 4] = [
    pair(entity(1), entity(2)),
    pair(entity(1), entity(3)),
    pair(entity(2), entity(2)),
    pair(entity(2), entity(3)),
];

const REASON: UnlinkedReason = UnlinkedReason::Descriptors;

fn books(there: [bool; 4]) -> UnlinkedPairs {
    let mut books = UnlinkedPairs::new();
    for it in PAIRS
        .into_iter()
        .zip(there)
        .filter(|(_, is)| *is)
        .map(|(it, _)| it)
    {
        books.reasons.insert(it, REASON);
        books.by_demanding.insert((it.demanding, it.offering));
        *books.offered.entry(it.offering.node).or_insert(0) += 1;
    }
    books
}

/// No node offers more unlinked pairs than its quota. A remembered pair is found from both sides,
/// and forgotten from both.
//= SM2-WCH-004 kani
// Shows MGR-QUOTA (Exhaustive), bound: one step from any state of 4 pairs, quota up to 3.
#[cfg_attr(kani, kani::proof)]
// Four pairs.
#[cfg_attr(kani, kani::unwind(7))]
fn unlinked_pairs_keep_their_quota() {
    let limit = below(4);
    let mut there: [bool; 4] = kani::any();
    let offered = |of: EntityId| {
        let pairs = PAIRS.into_iter().zip(there);
        pairs.filter(|(it, is)| *is && it.offering == of).count()
    };
    kani::assume(offered(entity(1)) <= limit && offered(entity(2)) <= limit);
    let mut books = books(there);
    assert!(books.agree(limit));
    let at = below(4);
    let is_there = there[at];
    match below(3) {
        0 => {
            let room = is_there || offered(PAIRS[at].offering) < limit;
            let reason = one_of(&[REASON, UnlinkedReason::Ended { code: Code(3) }]);
            assert_eq!(books.insert(PAIRS[at], reason, limit), room);
            assert_eq!(books.item(PAIRS[at]).is_some(), room);
            if room {
                // Only the last reason is remembered.
                assert_eq!(books.reasons.insert(PAIRS[at], REASON), Some(reason));
                there[at] = true;
            }
            kani::cover!(!room && limit > 0, "the quota is used up");
            kani::cover!(is_there, "known already");
        }
        1 => {
            assert_eq!(books.remove(PAIRS[at]), is_there);
            assert!(!books.remove(PAIRS[at]));
            there[at] = false;
        }
        _ => {
            let of = one_of(&[entity(1), entity(2), entity(3)]);
            let found: Vec<_> = books.of(of).collect();
            for (it, is) in PAIRS.into_iter().zip(there) {
                let is = is && (it.offering == of || it.demanding == of);
                assert_eq!(found.contains(&it), is);
            }
            kani::cover!(
                found.len() == 2 && of == entity(3),
                "from the demanding side"
            );
        }
    }
    assert!(books == self::books(there));
    assert!(books.agree(limit));
}

#[cfg(test)]
kani::explored! {
    unlinked_pairs_keep_their_quota: 3,
}
