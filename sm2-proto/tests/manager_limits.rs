//! The limits of a Manager (SPEC section 2): their ranges, and how nodes learn of them.

use sm2_proto::control::{Limit, LimitError, Limits};

/// Limits where only the range of this one, not the whole, can refuse a value.
fn wide(limit: Limit, value: u32) -> Limits {
    let mut limits = Limits::default();
    for each in Limit::ALL {
        limits = limits.with(each, *each.range().end());
    }
    let is_part = |it: &Limit| it.whole().is_some() && Some(*it) != limit.whole();
    for part in Limit::ALL.into_iter().filter(is_part) {
        limits = limits.with(part, *part.range().start());
    }
    limits.with(limit, value)
}

#[test]
fn the_defaults_are_accepted() {
    assert_eq!(Limits::default().check(), Ok(()));
}

#[test]
fn a_limit_is_set_alone() {
    let defaults = Limits::default();
    for limit in Limit::ALL {
        let limits = defaults.with(limit, 12_345);
        assert_eq!(limits.of(limit), 12_345, "{limit}");
        for other in Limit::ALL.into_iter().filter(|it| *it != limit) {
            assert_eq!(limits.of(other), defaults.of(other), "{limit}, {other}");
        }
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
        let above = most.checked_add(1);
        for value in [Some(0), Some(least - 1), above].into_iter().flatten() {
            let refused = LimitError::OutOfRange { limit, value };
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
        let limits = |value| wide(limit, value).with(whole, 5);
        assert_eq!(limits(5).check(), Ok(()), "{limit}");
        let refused = LimitError::AboveWhole {
            limit,
            value: 6,
            whole,
            most: 5,
        };
        assert_eq!(limits(6).check(), Err(refused), "{limit}");
    }
}

#[test]
fn a_refused_limit_names_itself_its_value_and_the_range() {
    let text = |limit, value| {
        let limits = Limits::default().with(limit, value);
        limits.check().unwrap_err().to_string()
    };
    assert_eq!(
        text(Limit::LinksPerSession, 65_537),
        "links_per_session is 65537: give 1 to 65536"
    );
    assert_eq!(
        text(Limit::Recovery, 0),
        "recovery_ms is 0 s: give 1 ms to 86400 s"
    );
    assert_eq!(
        text(Limit::SessionsPerProcess, 1_025),
        "sessions_per_process is 1025: give 1 to 1024, the value of sessions_per_user, or raise that one"
    );
}
