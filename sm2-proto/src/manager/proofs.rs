//! Harnesses for the Manager's tables and charges, and for sessions that begin and end.

use super::{
    Cause, Credentials, Input, Manager, Misuse, Output,
    counter_files::CounterFiles,
    outbox::Outbox,
    phase::{PHASES, Phase, TO_MANAGER_KINDS, ToManagerKind, legal},
    quota::within,
    users::Users,
};
use crate::{
    Code, Datagram, Farewell, FdFacts, Instant, Machine, Name, NodeId, Quota, Refusal, Seals,
    VERSION,
    control::{Limit, Limits, ToNode, encode_to_node},
    limits::LINKS_MAX,
    proofs::{below, one_of},
};

//= SM2-SES-001, SM2-RES-003 kani
// Shows MGR-STRICT (Exhaustive), bound: none: one step from any phase.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(14))]
fn session_phase_table() {
    let (phase, kind) = (one_of(&PHASES), one_of(&TO_MANAGER_KINDS));
    let claims = matches!(kind, ToManagerKind::Claim | ToManagerKind::Claimed);
    let verdict = legal(phase, kind);
    if kind == ToManagerKind::Goodbye {
        assert_eq!(verdict, Ok(()), "everybody may leave");
    } else if (phase == Phase::Greeting) == (kind == ToManagerKind::Hello) {
        let refused = phase == Phase::Ready && claims;
        assert_eq!(verdict.is_err(), refused);
        kani::cover!(refused, "a claim that is too late");
        kani::cover!(!refused, "a legal frame");
    } else if phase == Phase::Greeting {
        assert_eq!(verdict, Err(violation!(ExpectedHello, "SM2-SES-001")));
    } else {
        assert_eq!(verdict, Err(violation!(UnexpectedHello, "SM2-SES-001")));
    }
}

//= SM2-IFC-006 kani
// Shows MGR-QUOTA (BoundariesAndSamples), bound: any two numbers.
#[cfg_attr(kani, kani::proof)]
fn quota_is_exact() {
    let (limit, wanted): (usize, usize) = kani::any();
    match within(limit, wanted, Quota::LinksPerSession) {
        Ok(()) => assert!(wanted <= limit),
        Err(refusal) => {
            assert!(wanted > limit);
            let limit = u32::try_from(limit).unwrap_or(u32::MAX);
            let quota = Quota::LinksPerSession;
            assert!(refusal == Refusal::Quota { quota, limit });
        }
    }
    kani::cover!(wanted == limit && limit > 0, "exactly used up");
    kani::cover!(
        wanted > limit && limit > u32::MAX as usize,
        "wider than the wire"
    );
}

//= SM2-MAT-003 kani
// Shows MGR-SEAL (BoundariesAndSamples), bound: any policy.
#[cfg_attr(kani, kani::proof)]
fn users_apart_are_sealed() {
    let (seal_all, waive_user_boundary, same_user): (bool, bool, bool) = kani::any();
    let limits = Limits {
        seal_all,
        waive_user_boundary,
        ..Limits::default().with(Limit::LinksPerSession, kani::any())
    };
    let sealed = limits.seals(same_user);
    assert!(sealed || (!seal_all && (same_user || waive_user_boundary)));
    assert!(!sealed || seal_all || !(same_user || waive_user_boundary));
    assert!(limits.links_per_session() <= LINKS_MAX);
    kani::cover!(sealed && !seal_all, "sealed for the users' sake");
    kani::cover!(!sealed && !same_user, "waived");
}

/// A user whose processes have no numbers.
const fn user(uid: u32) -> Credentials {
    Credentials {
        uid,
        gid: 0,
        pid: 0,
    }
}

/// Connections of two users come, are welcomed, declare and leave.
//= SM2-IFC-006 kani
// Shows MGR-QUOTA (Exhaustive), bound: 6 steps from the beginning, 2 users.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(8))]
fn charges_end_at_zero() {
    let limits = Limits::default()
        .with(Limit::GreetingsPerUser, 1)
        .with(Limit::SessionsPerUser, 2)
        .with(Limit::InterfacesPerUser, 1);
    let mut users = Users::new();
    // By user: not welcomed, welcomed, interfaces.
    let mut held = [[0_usize; 3]; 2];
    for _ in 0..6 {
        let uid = u32::from(kani::any::<bool>());
        let [greeting, welcomed, interfaces] = &mut held[uid as usize];
        match kani::any_where(|step: &Option<bool>| step.is_some() || *welcomed > 0) {
            Some(true) => {
                *greeting += 1;
                assert_eq!(users.connect(user(uid), &limits), *greeting <= 1);
            }
            Some(false) => {
                kani::assume(*greeting > 0);
                (*greeting, *welcomed) = (*greeting - 1, *welcomed + 1);
                users.greet(user(uid));
            }
            None => {
                *interfaces += 1;
                users.declare(user(uid));
            }
        }
        assert_eq!(
            users.refuse_session(user(uid), &limits).is_ok(),
            *welcomed < 2
        );
        assert_eq!(
            users.refuse_interface(user(uid), &limits).is_ok(),
            *interfaces < 1
        );
    }
    kani::cover!(held[0][1] == 2, "no session left");
    kani::cover!(
        held[0][2] == 1 && held[1][2] == 1,
        "two users with interfaces"
    );
    for (uid, [greeting, welcomed, mut interfaces]) in (0..).zip(held) {
        for _ in 0..greeting {
            users.leave(user(uid), false, 0);
        }
        for _ in 0..welcomed {
            users.leave(user(uid), true, interfaces);
            interfaces = 0;
        }
    }
    assert!(users == Users::new());
}

const NOW: Instant = Instant(0);

/// The session that a harness is about.
const OURS: NodeId = NodeId(3);

/// A session that the harness must not affect.
const OTHER: NodeId = NodeId(4);

fn name(text: &str) -> Name {
    Name::new(text).expect("a legal name")
}

/// A Manager with two connections of one user.
fn manager(limits: Limits) -> Manager {
    let mut manager = Manager::new(7, 1, limits);
    for session in [OURS, OTHER] {
        manager.connect(NOW, session, user(1));
    }
    manager
}

/// Brings a connection into a phase.
fn bring(manager: &mut Manager, session: NodeId, phase: Phase, text: &str) {
    let resuming = phase == Phase::Resuming;
    if phase != Phase::Greeting {
        let welcomed = manager.hello(session, [1, 1], name(text), resuming);
        assert_eq!(welcomed, Ok(()));
    }
    assert_eq!(phase_of(manager, session), phase);
}

fn phase_of(manager: &Manager, session: NodeId) -> Phase {
    let session = manager.registry.sessions().get(session);
    session.expect("it is there").phase()
}

/// MGR-IDS: a connection is taken exactly if its number is greater than all before it.
//= SM2-SES-007 kani
// Shows MGR-IDS (BoundariesAndSamples), bound: any two numbers.
#[cfg_attr(kani, kani::proof)]
// One session.
#[cfg_attr(kani, kani::unwind(4))]
fn session_numbers_are_fresh() {
    let mut manager = Manager::new(7, 1, Limits::default());
    let (last, next): (u64, u64) = kani::any();
    manager.last_node = NodeId(last);
    let before = manager.clone();
    let session = NodeId(next);
    let credentials = user(1);
    let connected = Input::Connected {
        session,
        credentials,
    };
    let verdict = manager.handle(NOW, connected.clone());
    if next > last {
        assert_eq!(verdict, Ok(()));
        assert!(manager.last_node == session && manager.sessions() == 1);
        let again = manager.handle(NOW, connected);
        assert_eq!(
            again,
            Err(Misuse::SessionNumber(session).into()),
            "never used twice"
        );
    } else {
        assert_eq!(verdict, Err(Misuse::SessionNumber(session).into()));
        assert!(manager == before);
    }
    kani::cover!(next > last && next == u64::MAX, "the last number");
    kani::cover!(last == u64::MAX, "no number is left");
}

/// HELLO is granted exactly if no rule forbids it, and refused for the first rule that does.
//= SM2-SES-002, SM2-SES-003, SM2-IFC-006 kani
// Shows MGR-STRICT (Exhaustive), bound: 2 sessions; versions around the one that there is.
#[cfg_attr(kani, kani::proof)]
// Two sessions; names of one byte, frames of at most 12.
#[cfg_attr(kani, kani::unwind(14))]
fn hello_is_refused_in_order() {
    let (taken, quota_used, resuming): (bool, bool, bool) = kani::any();
    let limit = if quota_used { 1 } else { 2 };
    let mut manager = manager(Limits::default().with(Limit::SessionsPerUser, limit));
    bring(&mut manager, OTHER, Phase::Ready, "a");
    manager.outbox.0.clear();
    let (min, max): (u16, u16) = (any_version(), any_version());
    let verdict = manager.hello(
        OURS,
        [min, max],
        name(if taken { "a" } else { "b" }),
        resuming,
    );
    let phase = phase_of(&manager, OURS);
    if min == 0 || min > max {
        assert_eq!(verdict, Err(violation!(BadVersionRange, "SM2-SES-002")));
        assert!(manager.outbox.0.is_empty() && phase == Phase::Greeting);
        return;
    }
    assert_eq!(verdict, Ok(()));
    let refusal = if min > VERSION {
        Some(Refusal::Version { min: 1, max: 1 })
    } else if taken {
        Some(Refusal::NameTaken)
    } else if quota_used {
        let quota = Quota::SessionsPerUser;
        Some(Refusal::Quota { quota, limit: 1 })
    } else {
        None
    };
    let granted = refusal.is_none();
    let frame = encode_to_node(&match refusal {
        Some(reason) => ToNode::HelloRefused { reason },
        None => ToNode::Welcome {
            version: VERSION,
            epoch: 7,
            node: OURS,
        },
    });
    let answer = Output::Send {
        session: OURS,
        frame,
    };
    assert!(manager.outbox.0 == [answer]);
    let ready = if resuming {
        Phase::Resuming
    } else {
        Phase::Ready
    };
    assert!(phase == if granted { ready } else { Phase::Greeting });
    // A session that is not ready has a deadline.
    assert_eq!(manager.deadline().is_some(), phase != Phase::Ready);
    let has_name = |text| manager.registry.sessions().has_name(&name(text));
    assert!(has_name("a") && has_name("b") == granted);
    kani::cover!(
        granted && resuming && max > VERSION,
        "a newer node comes back"
    );
    kani::cover!(taken && quota_used && min > VERSION, "three reasons");
}

/// Versions around the one that there is.
fn any_version() -> u16 {
    one_of(&[0, 1, 2, u16::MAX])
}

/// MGR-ABSORB: a session ends once, with a GOODBYE if one is due. After that no input for it has
/// any effect, and no other session notices.
//= SM2-SES-001, SM2-SES-005, SM2-SES-006, SM2-RES-003 kani
// Shows MGR-ABSORB (Exhaustive), bound: 2 sessions in any phases without interfaces; 5 ends, 5 late inputs.
#[cfg_attr(kani, kani::proof)]
// Two sessions; frames of one byte.
#[cfg_attr(kani, kani::unwind(14))]
fn an_ended_session_is_silent() {
    let mut manager = manager(Limits::default());
    let (phase, theirs) = (one_of(&PHASES), one_of(&PHASES));
    bring(&mut manager, OURS, phase, "a");
    bring(&mut manager, OTHER, theirs, "b");
    manager.outbox.0.clear();
    let bystander = manager.registry.sessions().get(OTHER).cloned();
    let session = OURS;
    let datagram = |bytes| Input::Datagram {
        session,
        datagram: Datagram::new(bytes),
    };
    // CLAIMED; 16 is not a frame.
    let early = match phase {
        Phase::Greeting => Cause::Violation(violation!(ExpectedHello, "SM2-SES-001")),
        _ => Cause::Violation(violation!(UnexpectedClaim, "SM2-RES-003")),
    };
    let (input, cause) = match below(5) {
        0 => {
            kani::assume(phase != Phase::Resuming);
            (datagram(&[7]), early)
        }
        1 => (
            datagram(&[16]),
            Cause::Violation(violation!(UnknownFrame, "SM2-FRM-001")),
        ),
        2 => (datagram(&[5, 9]), Cause::Goodbye(Code(9))),
        3 => (Input::Closed { session }, Cause::Gone),
        _ => (
            Input::Stalled { session },
            Cause::Farewell(Farewell::Stalled),
        ),
    };
    assert_eq!(manager.handle(NOW, input), Ok(()));
    let goodbye = match cause {
        Cause::Violation(violation) => Some(violation.code()),
        Cause::Farewell(farewell) => Some(farewell.code()),
        Cause::Gone | Cause::Goodbye(_) => None,
    };
    let goodbye = goodbye.map(|code| encode_to_node(&ToNode::Goodbye { code }));
    let hang_up = Output::HangUp {
        session,
        goodbye,
        cause,
    };
    assert!(manager.poll() == Some(hang_up) && manager.poll().is_none());
    let late = match below(5) {
        0 => datagram(&[7]),
        1 => datagram(&[16]),
        2 => datagram(&[5, 9]),
        3 => Input::Closed { session },
        _ => Input::Stalled { session },
    };
    let before = manager.clone();
    assert_eq!(manager.handle(NOW, late), Ok(()));
    assert!(manager == before && manager.poll().is_none());
    let other = manager.registry.sessions().get(OTHER);
    assert!(manager.sessions() == 1 && other == bystander.as_ref());
    let has_name = |text| manager.registry.sessions().has_name(&name(text));
    assert!(!has_name("a") && has_name("b") == (theirs != Phase::Greeting));
    kani::cover!(
        cause == early && phase == Phase::Ready,
        "a claim that is too late"
    );
    kani::cover!(
        cause == Cause::Gone && phase == Phase::Resuming,
        "gone while it resumes"
    );
}

/// A file of counters is kept once, and only as a regular file with its seals and a legal size.
//= SM2-CNT-001, SM2-CNT-004 kani
// Shows DAT-SEALED (BoundariesAndSamples), bound: any size, any of the first six seals.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(14))]
fn counters_are_kept_once() {
    let (mut files, mut outbox) = (CounterFiles::new(), Outbox::new());
    let file = FdFacts {
        regular: kani::any(),
        size_bytes: kani::any(),
        // The first six seals of the kernel.
        seals: Seals(below(64) as u32),
    };
    let bits = file.seals.0 & 0x17 == 0x17;
    let size = file.size_bytes;
    let expected = if !file.regular {
        Err(violation!(NotAMemfd, "SM2-CNT-001"))
    } else if !bits {
        Err(violation!(SealsMissing, "SM2-CNT-001"))
    } else if !size.is_multiple_of(512) || !(1_024..=4_194_304).contains(&size) {
        Err(violation!(BadSize, "SM2-CNT-001"))
    } else {
        Ok(())
    };
    let verdict = files.keep(NOW, OURS, Some(&file), &mut outbox);
    assert_eq!(verdict, expected);
    let kept = outbox.0.pop_front();
    assert_eq!(
        kept == Some(Output::KeepCounters { session: OURS }),
        expected.is_ok()
    );
    if expected.is_ok() {
        let again = files.keep(NOW, OURS, Some(&file), &mut outbox);
        assert_eq!(again, Err(violation!(CountersTwice, "SM2-CNT-001")));
    }
    assert!(outbox.0.is_empty());
    kani::cover!(expected.is_ok(), "kept");
    kani::cover!(
        expected == Err(violation!(BadSize, "SM2-CNT-001")),
        "a size that is not legal"
    );
}

#[cfg(test)]
kani::explored! {
    session_phase_table: 2,
    quota_is_exact: 2,
    users_apart_are_sealed: 2,
    charges_end_at_zero: 2,
    session_numbers_are_fresh: 2,
    hello_is_refused_in_order: 2,
    an_ended_session_is_silent: 2,
    counters_are_kept_once: 2,
}
