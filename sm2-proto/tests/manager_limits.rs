//! The limits of a Manager (SPEC section 2): their ranges, and how nodes learn of them.

use sm2_proto::{
    control::{Limit, LimitError},
    manager::Policy,
};

fn with(limit: Limit, value: u64) -> Policy {
    let mut policy = Policy::default();
    policy.set(limit, value);
    policy
}

/// A policy in which only the range of a limit, not its whole, can refuse a value.
fn wide(limit: Limit, value: u64) -> Policy {
    let mut policy = Policy::default();
    for each in Limit::ALL {
        policy.set(each, *each.range().end());
    }
    let is_part = |it: &Limit| it.whole().is_some() && Some(*it) != limit.whole();
    for part in Limit::ALL.into_iter().filter(is_part) {
        policy.set(part, *part.range().start());
    }
    policy.set(limit, value);
    policy
}

#[test]
fn the_default_policy_is_accepted() {
    assert_eq!(Policy::default().check(), Ok(()));
}

//= SM2-WCH-005 test
#[test]
fn each_limit_is_shown_as_it_is_set() {
    let defaults = Policy::default().limits();
    for limit in Limit::ALL {
        let policy = with(limit, 12_345);
        assert_eq!(policy.value(limit), 12_345, "{limit}");
        let shown = policy.limits();
        assert_eq!(shown.of(limit), 12_345, "{limit}");
        for other in Limit::ALL.into_iter().filter(|it| *it != limit) {
            assert_eq!(shown.of(other), defaults.of(other), "{limit}, {other}");
        }
    }
}

//= SM2-WCH-005 test
#[test]
fn a_value_that_a_frame_cannot_carry_is_shown_as_the_greatest() {
    for limit in Limit::ALL {
        let shown = u64::from(with(limit, u64::MAX).limits().of(limit));
        let most = match limit {
            Limit::LinksPerSession => *limit.range().end(),
            _ => u32::MAX.into(),
        };
        assert_eq!(shown, most, "{limit}");
    }
}

#[test]
fn a_value_outside_of_the_range_is_refused() {
    for limit in Limit::ALL {
        let (least, most) = (*limit.range().start(), *limit.range().end());
        assert!(least > 0, "{limit}");
        for value in [least, most] {
            assert_eq!(wide(limit, value).check(), Ok(()), "{limit}");
        }
        for value in [0, least - 1, most + 1, u64::MAX] {
            let refused = LimitError::OutOfRange {
                limit,
                value: with(limit, value).value(limit),
            };
            assert_eq!(wide(limit, value).check(), Err(refused), "{limit}");
        }
    }
}

#[test]
fn a_limit_of_a_part_is_at_most_that_of_the_whole() {
    for limit in Limit::ALL {
        let Some(whole) = limit.whole() else {
            continue;
        };
        let policy = |value| {
            let mut policy = wide(limit, value);
            policy.set(whole, 5);
            policy
        };
        assert_eq!(policy(5).check(), Ok(()), "{limit}");
        let refused = LimitError::AboveWhole {
            limit,
            value: 6,
            whole,
            most: 5,
        };
        assert_eq!(policy(6).check(), Err(refused), "{limit}");
    }
}

#[test]
fn a_refused_limit_names_its_option_its_value_and_the_range() {
    let text = |limit, value| with(limit, value).check().unwrap_err().to_string();
    assert_eq!(
        text(Limit::LinksPerSession, 65_537),
        "--max-links is 65537: give 1 to 65536"
    );
    assert_eq!(
        text(Limit::Recovery, 0),
        "--recovery-timeout is 0 s: give 1 ms to 86400 s"
    );
    assert_eq!(
        text(Limit::SessionsPerProcess, 1_025),
        "--max-process-sessions is 1025: give 1 to 1024, the value of --max-sessions, or raise that one"
    );
}
