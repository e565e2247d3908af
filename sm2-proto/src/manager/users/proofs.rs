//! Harnesses for the usage of users: one step from any usage.

use super::{super::quota::count, Credentials, Owner, Quota, Refusal, Usage, Users};
use crate::control::{Limit, Limits};
use crate::proofs::{below, one_of};

/// A user whose processes have no numbers.
const fn user(uid: u32) -> Credentials {
    Credentials {
        uid,
        gid: 0,
        pid: 0,
    }
}

/// MGR-CHARGES: each step changes the counts that it is about, and those of no other user. A user
/// without any usage has no entry. The counts decide refusals.
//= SM2-IFC-006 kani
// Shows MGR-QUOTA (BoundariesAndSamples), bound: one step from any charges.
#[cfg_attr(kani, kani::proof)]
// Two users.
#[cfg_attr(kani, kani::unwind(4))]
fn a_step_changes_its_own_charge() {
    // No machine has as many connections as there are numbers.
    let any = || kani::any_where(|count: &usize| *count < usize::MAX - 1);
    let (greeting, welcomed, interfaces) = (one_of(&[0, 1, 2, 9]), any(), any());
    let mut usage = Usage {
        greeting,
        welcomed,
        interfaces,
    };
    let bystander = Usage {
        welcomed: 1,
        ..Usage::default()
    };
    let mut users = Users::new();
    users.0.insert(Owner::User(2), bystander);
    if usage != Usage::default() {
        users.0.insert(Owner::User(1), usage);
    }
    let limit: u32 = kani::any();
    let limits = Limits::default()
        .with(Limit::GreetingsPerUser, limit)
        .with(Limit::SessionsPerUser, limit)
        .with(Limit::InterfacesPerUser, limit);
    match below(5) {
        0 => {
            usage.greeting += 1;
            assert_eq!(
                users.connect(user(1), &limits),
                usage.greeting <= limits.count(Limit::GreetingsPerUser)
            );
        }
        1 => {
            // A connection that is welcomed was greeting before.
            kani::assume(greeting > 0);
            (usage.greeting, usage.welcomed) = (greeting - 1, welcomed + 1);
            users.greet(user(1));
        }
        2 => {
            usage.interfaces += 1;
            users.declare(user(1));
        }
        3 => {
            let was_welcomed = kani::any();
            let all = kani::any::<bool>();
            let owned = if all { interfaces } else { 0 };
            let left = if was_welcomed {
                &mut usage.welcomed
            } else {
                &mut usage.greeting
            };
            kani::assume(*left > 0);
            *left -= 1;
            usage.interfaces -= owned;
            users.leave(user(1), was_welcomed, owned);
            kani::cover!(usage == Usage::default(), "the last one left");
        }
        _ => {
            kani::assume(interfaces > 0);
            usage.interfaces -= 1;
            users.withdraw(user(1), 1);
        }
    }
    assert!(users.0.get(&Owner::User(2)) == Some(&bystander));
    let charged = users.0.get(&Owner::User(1)).copied();
    assert!(charged == (usage != Usage::default()).then_some(usage));
    assert_refusals(&users, usage, &limits);
}

/// The quotas of user 1 refuse exactly the requests that exceed them.
fn assert_refusals(users: &Users, usage: Usage, limits: &Limits) {
    let limit = limits.count(Limit::SessionsPerUser);
    let refused = |quota| {
        let limit = count(limit);
        Err(Refusal::Quota { quota, limit })
    };
    let session = if usage.welcomed < limit {
        Ok(())
    } else {
        refused(Quota::SessionsPerUser)
    };
    assert_eq!(users.refuse_session(user(1), limits), session);
    let has_room = usage.interfaces < limit;
    let interface = if has_room {
        Ok(())
    } else {
        refused(Quota::InterfacesPerUser)
    };
    assert_eq!(users.refuse_interface(user(1), limits), interface);
    kani::cover!(!has_room && limit > 0, "used up");
}

#[cfg(test)]
kani::explored! {
    a_step_changes_its_own_charge: 2,
}
