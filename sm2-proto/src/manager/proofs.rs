//! Harnesses for the Manager's tables and charges.

use super::{
    phase::{PHASES, Phase, REQUESTS, Request, legal},
    policy::{Policy, Users, within},
};
use crate::{Quota, Refusal, Violation, limits::LINKS_MAX};

//= SM2-SES-001, SM2-RES-003 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(14))]
fn session_phase_table() {
    let phase = PHASES[usize::from(kani::any_where(|at: &u8| *at < 3))];
    let request = REQUESTS[usize::from(kani::any_where(|at: &u8| *at < 13))];
    let claims = matches!(request, Request::Claim | Request::Claimed);
    let verdict = legal(phase, request);
    if request == Request::Goodbye {
        assert_eq!(verdict, Ok(()), "everybody may leave");
    } else if (phase == Phase::Greeting) == (request == Request::Hello) {
        let refused = phase == Phase::Ready && claims;
        assert_eq!(verdict.is_err(), refused);
        kani::cover!(refused, "a claim that is too late");
        kani::cover!(!refused, "a legal request");
    } else if phase == Phase::Greeting {
        assert_eq!(verdict, Err(Violation::ExpectedHello));
    } else {
        assert_eq!(verdict, Err(Violation::UnexpectedHello));
    }
}

//= SM2-IFC-006 kani
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
#[cfg_attr(kani, kani::proof)]
fn users_apart_are_sealed() {
    let (seal_all, waive_user_boundary, same_user): (bool, bool, bool) = kani::any();
    let policy = Policy {
        seal_all,
        waive_user_boundary,
        links_per_session: kani::any(),
        ..Policy::default()
    };
    let sealed = policy.seals(same_user);
    assert!(sealed || (!seal_all && (same_user || waive_user_boundary)));
    assert!(!sealed || seal_all || !(same_user || waive_user_boundary));
    assert!(policy.links_per_session() <= LINKS_MAX);
    kani::cover!(sealed && !seal_all, "sealed for the users' sake");
    kani::cover!(!sealed && !same_user, "waived");
}

/// Connections of two users come, are welcomed, declare and leave.
//= SM2-IFC-006 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(8))]
fn charges_end_at_zero() {
    let policy = Policy {
        greetings_per_user: 1,
        sessions_per_user: 2,
        interfaces_per_user: 1,
        ..Policy::default()
    };
    let mut users = Users::new();
    // By user: not welcomed, welcomed, interfaces.
    let mut held = [[0_usize; 3]; 2];
    for _ in 0..6 {
        let uid = u32::from(kani::any::<bool>());
        let [greeting, welcomed, interfaces] = &mut held[uid as usize];
        match kani::any_where(|step: &Option<bool>| step.is_some() || *welcomed > 0) {
            Some(true) => {
                *greeting += 1;
                assert_eq!(users.connect(uid, &policy), *greeting <= 1);
            }
            Some(false) => {
                kani::assume(*greeting > 0);
                (*greeting, *welcomed) = (*greeting - 1, *welcomed + 1);
                users.greet(uid);
            }
            None => {
                *interfaces += 1;
                users.declare(uid);
            }
        }
        assert_eq!(users.refuse_session(uid, &policy).is_ok(), *welcomed < 2);
        assert_eq!(
            users.refuse_interface(uid, &policy).is_ok(),
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
            users.leave(uid, false, 0);
        }
        for _ in 0..welcomed {
            users.leave(uid, true, interfaces);
            interfaces = 0;
        }
    }
    assert!(users == Users::new());
}

#[cfg(test)]
kani::explored! {
    session_phase_table: 2,
    quota_is_exact: 2,
    users_apart_are_sealed: 2,
    charges_end_at_zero: 2,
}
