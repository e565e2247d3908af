//! Harnesses for the calls of a link: one step from any state of three calls.

use alloc::collections::BTreeSet;

use super::{Call, Got, Misuse, Placed, Reply, Served, Status};
use crate::{
    GrowingMap,
    limits::CALLS_MAX,
    proofs::{below, one_of},
};

/// The ids of the calls. The next call has the id 4.
const CALLS: [u64; 3] = [1, 2, 3];

/// The state of a call at its caller, and whether its CANCEL has to be sent. `None`: the call has
/// its reply.
fn any_placed() -> Option<(Call, bool)> {
    let (sent, cancelled, due): (bool, bool, bool) = kani::any();
    kani::assume(!due || (sent && cancelled));
    kani::any::<bool>().then_some((Call { sent, cancelled }, due))
}

fn placed(calls: [Option<(Call, bool)>; 3]) -> Placed {
    let mut books = Placed::default();
    for (id, call) in CALLS.into_iter().zip(calls) {
        if let Some((call, due)) = call {
            books.calls.insert(id, call);
            books.cancels.extend(due.then_some(id));
        }
    }
    books.invariants();
    books
}

/// At the caller: a call that was sent gets exactly one reply. CANCEL is sent at most once, and
/// only for a call that was sent and has no reply yet.
//= SM2-SRV-001, SM2-SRV-002, SM2-SRV-003, SM2-SRV-004 kani
// Shows LNK-CALLS (Exhaustive), bound: one step from any state of 3 calls.
#[cfg_attr(kani, kani::proof)]
// Three calls, so trees have at most four entries.
#[cfg_attr(kani, kani::unwind(6))]
fn a_call_is_answered_once() {
    // The tree's neighbours of a call are the only other calls that matter, so three calls suffice.
    let mut calls = [any_placed(), any_placed(), any_placed()];
    let mut books = placed(calls);
    let at = below(4);
    let id = at as u64 + 1;
    let call = calls.get(at).copied().flatten();
    match below(5) {
        0 => reply_comes(&mut books, &mut calls, at),
        1 => {
            kani::assume(call.is_some_and(|(call, _)| !call.sent));
            books.sent(id);
            if let Some((call, due)) = &mut calls[at] {
                (call.sent, *due) = (true, call.cancelled);
                kani::cover!(*due, "cancelled before it left");
            }
        }
        2 => {
            let made = id <= 3;
            let expected = if made {
                Ok(())
            } else {
                Err(Misuse::UnknownCall)
            };
            assert_eq!(books.cancel(id, Some(3)), expected);
            if let Some(Some((call, due))) = calls.get_mut(at) {
                *due = *due || (call.sent && !call.cancelled);
                call.cancelled = true;
            }
        }
        3 => {
            let due = |call: &Option<(Call, bool)>| call.is_some_and(|(_, due)| due);
            let first = calls.iter().position(due);
            assert_eq!(books.poll(), first.map(|at| CALLS[at]));
            if let Some(at) = first {
                let (call, due) = calls[at].as_mut().expect("a call");
                *due = false;
                assert!(call.sent && call.cancelled);
            }
        }
        _ => {
            let lost = books.end();
            let open = CALLS.into_iter().zip(calls).filter(|(_, it)| it.is_some());
            assert!(open.map(|(id, _)| id).eq(lost), "each fails, once");
            assert!(books == Placed::default());
            return;
        }
    }
    assert!(books == placed(calls));
    assert_eq!(books.len(), calls.iter().flatten().count());
}

/// A reply comes to the call at this index, or to a call that was not made.
fn reply_comes(books: &mut Placed, calls: &mut [Option<(Call, bool)>; 3], at: usize) {
    let id = at as u64 + 1;
    let call = calls.get(at).copied().flatten();
    let status = one_of(&Status::ALL);
    let len = u64::from(kani::any::<bool>());
    let sent = call.is_some_and(|(call, _)| call.sent);
    let empty = matches!(status, Status::Cancelled | Status::DeadlinePassed);
    let expected = if !sent {
        Err(violation!(UnknownCall, "SM2-SRV-002"))
    } else if empty && len > 0 {
        Err(violation!(BadLength, "SM2-SRV-002"))
    } else {
        Ok(())
    };
    assert_eq!(books.check_reply(id, status, len), expected);
    kani::cover!(
        expected == Err(violation!(BadLength, "SM2-SRV-002")),
        "a reply that must be empty"
    );
    if expected.is_ok() {
        books.replied(id);
        calls[at] = None;
        let again = books.check_reply(id, status, len);
        assert_eq!(
            again,
            Err(violation!(UnknownCall, "SM2-SRV-002")),
            "answered once"
        );
        kani::cover!(true, "answered");
    }
}

/// The state of a call at its server. `None`: its REPLY was released, or its REQUEST never came.
fn any_got() -> Option<Got> {
    let reply = one_of(&[Reply::Owed, Reply::Queued, Reply::Sent]);
    let cancelled = kani::any();
    kani::any::<bool>().then_some(Got { reply, cancelled })
}

fn served(calls: [Option<Got>; 4]) -> Served {
    let open = |got: &&Got| got.reply != Reply::Sent;
    let books = Served {
        calls: (1..)
            .zip(calls)
            .filter_map(|(id, got)| Some((id, got?)))
            .collect(),
        open: calls.iter().flatten().filter(open).count(),
        last: Some(if calls[3].is_some() { 4 } else { 3 }),
        early: BTreeSet::new(),
    };
    books.invariants();
    books
}

/// At the server: each call gets exactly one reply, and can be cancelled at most once until its
/// REPLY is released.
//= SM2-SRV-001, SM2-SRV-002, SM2-SRV-003 kani
// Shows LNK-CALLS (Exhaustive), bound: one step from any state of 3 calls.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(6))]
fn a_call_is_replied_to_once() {
    let mut calls = [any_got(), any_got(), any_got(), None];
    let mut books = served(calls);
    let at = below(4);
    let id = at as u64 + 1;
    let got = calls[at];
    let owed = got.is_some_and(|got| got.reply == Reply::Owed);
    match below(5) {
        0 => request_comes(&mut books, &mut calls, at),
        1 => {
            let expected = match got {
                None => Err(violation!(UnknownCall, "SM2-SRV-003")),
                Some(got) if got.cancelled => Err(violation!(BadCancel, "SM2-SRV-003")),
                Some(_) => Ok(owed),
            };
            assert_eq!(books.cancel(id), expected);
            if let Some(got) = &mut calls[at] {
                got.cancelled = true;
            }
            kani::cover!(expected == Ok(false), "CANCEL crossed the REPLY");
        }
        2 => {
            let expected = if owed {
                Ok(())
            } else {
                Err(Misuse::UnknownCall)
            };
            assert_eq!(books.check(id), expected);
            if let (true, Some(got)) = (owed, &mut calls[at]) {
                books.reply(id);
                got.reply = Reply::Queued;
                assert_eq!(books.check(id), Err(Misuse::UnknownCall), "replied to once");
            }
        }
        3 => {
            books.sent(id);
            if let Some(
                got @ Got {
                    reply: Reply::Queued,
                    ..
                },
            ) = &mut calls[at]
            {
                got.reply = Reply::Sent;
                kani::cover!(true, "the REPLY left");
            }
        }
        _ => {
            // Only a REPLY that was sent can be released.
            kani::assume(got.is_none_or(|got| got.reply == Reply::Sent));
            books.released(id);
            calls[at] = None;
        }
    }
    assert!(books == served(calls));
    assert_eq!(books.len(), books.open);
}

/// A request comes with the number of the call at this index.
fn request_comes(books: &mut Served, calls: &mut [Option<Got>; 4], at: usize) {
    let id = at as u64 + 1;
    let expected = if at < 3 {
        Err(violation!(BadId, "SM2-SRV-001"))
    } else {
        Ok(())
    };
    assert_eq!(books.check_request(id), expected);
    if expected.is_ok() {
        books.requested(id);
        let (reply, cancelled) = (Reply::Owed, false);
        calls[at] = Some(Got { reply, cancelled });
        assert_eq!(
            books.check_request(id),
            Err(violation!(BadId, "SM2-SRV-001")),
            "numbers grow"
        );
    }
}

/// CALL-CANCEL: on the ring lane, CANCEL may come before its request and after its reply. CANCEL is
/// refused only if no caller that obeys SPEC can have sent it: a second CANCEL for one call, a
/// CANCEL for a call that then does not come, or more CANCELs than requests can be in the ring.
//= SM2-RNG-011 kani
// Shows CALL-CANCEL (Exhaustive), bound: one step from any state of 2 calls that were taken and 3 to come.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(6))]
fn a_cancel_of_any_time() {
    // Two calls were taken, and the ring has room for two more.
    let owed: Option<bool> = kani::any::<bool>().then(kani::any);
    let got = |cancelled| Got {
        reply: Reply::Owed,
        cancelled,
    };
    let early: [bool; 3] = kani::any();
    kani::assume(early.iter().filter(|it| **it).count() <= 2);
    let ids = |early: [bool; 3]| (3..).zip(early).filter_map(|(id, it)| it.then_some(id));
    let before = Served {
        calls: owed.map(|it| (2, got(it))).into_iter().collect(),
        open: usize::from(owed.is_some()),
        last: Some(2),
        early: ids(early).collect(),
    };
    let mut books = before.clone();
    let call = 1 + below(5) as u64;
    let remembered = (call > 2).then(|| early[call as usize - 3]);
    if kani::any() {
        let verdict = books.cancel_of_ring(call, 2);
        let expected = match remembered {
            Some(true) => Err(violation!(BadCancel, "SM2-RNG-011")),
            Some(false) if before.early.len() == 2 => Err(violation!(UnknownCall, "SM2-RNG-011")),
            None if call == 2 && owed == Some(true) => Err(violation!(BadCancel, "SM2-RNG-011")),
            None if call == 2 && owed == Some(false) => Ok(true),
            _ => Ok(false),
        };
        assert_eq!(verdict, expected);
        assert_eq!(
            books.early.contains(&call),
            verdict.is_ok() && call > 2 || remembered == Some(true)
        );
        kani::cover!(verdict == Ok(false) && call == 1, "too late");
        kani::cover!(verdict == Ok(false) && call > 2, "too early");
    } else {
        let verdict = books.taken_from_ring(call);
        let expected = match remembered {
            None => Err(violation!(BadId, "SM2-SRV-001")),
            Some(_) if ids(early).any(|it| it < call) => {
                Err(violation!(UnknownCall, "SM2-RNG-011"))
            }
            Some(cancelled) => Ok(cancelled),
        };
        assert_eq!(verdict, expected);
        match verdict {
            Ok(cancelled) => {
                assert!(books.calls.get(call) == Some(&got(cancelled)));
                assert!(!books.early.contains(&call) && books.last == Some(call));
            }
            Err(_) => assert!(books == before),
        }
        kani::cover!(verdict == Ok(true), "cancelled before it came");
        kani::cover!(
            verdict == Err(violation!(UnknownCall, "SM2-RNG-011")),
            "it never came"
        );
    }
    books.invariants();
}

/// Each end accepts exactly 1,024 open calls.
//= SM2-SRV-001 kani
// Shows LNK-LIMITS (Exhaustive), bound: 1,023 or 1,024 calls.
#[cfg_attr(kani, kani::proof)]
// All 1,024 calls, and the next one.
#[cfg_attr(kani, kani::unwind(1026))]
fn no_more_calls_than_the_limit() {
    let open = CALLS_MAX - below(2);
    let ids = 1..=open as u64;
    let books = Placed {
        calls: ids.clone().map(|id| (id, Call::default())).collect(),
        ..Placed::default()
    };
    books.invariants();
    let full = open == CALLS_MAX;
    assert_eq!(
        books.check(),
        if full { Err(Misuse::CallLimit) } else { Ok(()) }
    );
    let (reply, cancelled) = (Reply::Owed, false);
    let calls: GrowingMap<_, _> = ids.map(|id| (id, Got { reply, cancelled })).collect();
    let last = Some(open as u64);
    let mut books = Served {
        calls,
        open,
        last,
        early: BTreeSet::new(),
    };
    books.invariants();
    let next = open as u64 + 1;
    let expected = if full {
        Err(violation!(CallLimit, "SM2-SRV-001"))
    } else {
        Ok(())
    };
    assert_eq!(books.check_request(next), expected);
    // A call whose REPLY was sent no longer counts.
    books.reply(1);
    books.sent(1);
    assert_eq!(books.check_request(next), Ok(()));
    kani::cover!(full, "one too many");
}

#[cfg(test)]
kani::explored! {
    a_call_is_answered_once: 3,
    a_call_is_replied_to_once: 2,
    a_cancel_of_any_time: 4,
    no_more_calls_than_the_limit: 1,
}
