//! Harnesses for the requests of a session: one step from any state.

use super::{Misuse, NodeId, Requests};
use crate::proofs::{below, one_of};

/// An answer is legal exactly while its request is open, in the order of the requests. Each
/// request is answered once.
//= SM2-IFC-007, SM2-WCH-001, SM2-CNT-001, SM2-CNT-003, SM2-ACC-016 kani
// Shows CLI-STRICT (Exhaustive), bound: one step from any state of up to 2 questions of a kind.
#[cfg_attr(kani, kani::proof)]
// At most two requests of a kind.
#[cfg_attr(kani, kani::unwind(4))]
fn answers_need_questions() {
    let queries = one_of(&[0, 1, 2, u64::MAX]);
    let (watching, counters, reloading): (bool, bool, bool) = kani::any();
    let inspecting = one_of(&[&[][..], &[NodeId(1)], &[NodeId(1), NodeId(2)]]);
    let mut requests = Requests {
        queries,
        watching,
        counters,
        reloading,
        inspecting: inspecting.iter().copied().collect(),
        ..Requests::default()
    };
    match below(7) {
        0 => {
            let expected = if queries > 0 {
                Ok(())
            } else {
                Err(violation!(UnexpectedPage, "SM2-IFC-007"))
            };
            assert_eq!(requests.page(), expected);
            assert_eq!(requests.queries, queries.saturating_sub(1));
        }
        1 => {
            let expected = if watching {
                Ok(())
            } else {
                Err(violation!(UnexpectedChanges, "SM2-WCH-001"))
            };
            assert_eq!(requests.changes(), expected);
            assert_eq!(
                requests.changes(),
                Err(violation!(UnexpectedChanges, "SM2-WCH-001")),
                "answered once"
            );
        }
        2 => {
            let expected = if watching {
                Err(Misuse::WatchTwice)
            } else {
                Ok(())
            };
            assert_eq!(requests.watch(), expected);
            assert_eq!(requests.watch(), Err(Misuse::WatchTwice));
        }
        3 => {
            let expected = if counters {
                Err(Misuse::CountersTwice)
            } else {
                Ok(())
            };
            assert_eq!(requests.counters(), expected);
            assert_eq!(requests.counters(), Err(Misuse::CountersTwice));
        }
        4 => inspected(&mut requests, inspecting),
        5 => reload(&mut requests),
        _ => {
            requests.inspect(NodeId(3));
            assert_eq!(requests.inspecting.back(), Some(&NodeId(3)));
        }
    }
}

/// RELOADED answers the one RELOAD.
fn reload(requests: &mut Requests) {
    let reloading = requests.reloading;
    if kani::any() {
        let twice = Err(Misuse::ReloadTwice);
        assert_eq!(requests.reload(), if reloading { twice } else { Ok(()) });
        assert_eq!(requests.reload(), twice);
    } else {
        let unexpected = Err(violation!(UnexpectedReloaded, "SM2-ACC-016"));
        let expected = if reloading { Ok(()) } else { unexpected };
        assert_eq!(requests.reloaded(), expected);
        assert_eq!(requests.reloaded(), unexpected, "answered once");
    }
}

/// INSPECTED answers the oldest INSPECT and no other one.
fn inspected(requests: &mut Requests, inspecting: &[NodeId]) {
    let before = requests.clone();
    let node = one_of(&[NodeId(1), NodeId(2)]);
    let is_first = inspecting.first() == Some(&node);
    let expected = if is_first {
        Ok(())
    } else {
        Err(violation!(UnexpectedCounters, "SM2-CNT-003"))
    };
    assert_eq!(requests.inspected(node), expected);
    assert_eq!(
        requests.inspecting.len(),
        inspecting.len() - usize::from(is_first)
    );
    assert!(is_first || *requests == before);
    kani::cover!(!is_first && inspecting.contains(&node), "out of order");
    kani::cover!(is_first && inspecting.len() == 2, "the first of two");
}

#[cfg(test)]
kani::explored! {
    answers_need_questions: 2,
}
