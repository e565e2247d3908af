//! Harnesses for a session's questions: one step from any state of the books.

use super::{Misuse, NodeId, Requests};
use crate::proofs::{below, one_of};

/// An answer is legal exactly while its question is open, in the order of the questions; each
/// question is answered once.
//= SM2-IFC-007, SM2-WCH-001, SM2-CNT-001, SM2-CNT-002 kani
#[cfg_attr(kani, kani::proof)]
// At most two questions of a kind.
#[cfg_attr(kani, kani::unwind(4))]
fn answers_need_questions() {
    let queries = one_of(&[0, 1, 2, u64::MAX]);
    let (watching, counters): (bool, bool) = kani::any();
    let inspecting = one_of(&[&[][..], &[NodeId(1)], &[NodeId(1), NodeId(2)]]);
    let mut books = Requests {
        queries,
        watching,
        counters,
        inspecting: inspecting.iter().copied().collect(),
        ..Requests::default()
    };
    let before = books.clone();
    match below(6) {
        0 => {
            let expected = if queries > 0 {
                Ok(())
            } else {
                Err(violation!(UnexpectedPage, "SM2-IFC-007"))
            };
            assert_eq!(books.page(), expected);
            assert_eq!(books.queries, queries.saturating_sub(1));
        }
        1 => {
            let expected = if watching {
                Ok(())
            } else {
                Err(violation!(UnexpectedChanges, "SM2-WCH-001"))
            };
            assert_eq!(books.changes(), expected);
            assert_eq!(
                books.changes(),
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
            assert_eq!(books.watch(), expected);
            assert_eq!(books.watch(), Err(Misuse::WatchTwice));
        }
        3 => {
            let expected = if counters {
                Err(Misuse::CountersTwice)
            } else {
                Ok(())
            };
            assert_eq!(books.counters(), expected);
            assert_eq!(books.counters(), Err(Misuse::CountersTwice));
        }
        4 => {
            let node = one_of(&[NodeId(1), NodeId(2)]);
            let first = inspecting.first() == Some(&node);
            let expected = if first {
                Ok(())
            } else {
                Err(violation!(UnexpectedCounters, "SM2-CNT-002"))
            };
            assert_eq!(books.inspected(node), expected);
            assert_eq!(
                books.inspecting.len(),
                inspecting.len() - usize::from(first)
            );
            assert!(first || books == before);
            kani::cover!(!first && inspecting.contains(&node), "out of order");
            kani::cover!(first && inspecting.len() == 2, "the first of two");
        }
        _ => {
            books.inspect(NodeId(3));
            assert_eq!(books.inspecting.back(), Some(&NodeId(3)));
        }
    }
}

#[cfg(test)]
kani::explored! {
    answers_need_questions: 2,
}
