//! The decision whether a program that has ended is started again, and when.

use std::time::Duration;

use super::{
    limits::{FIRST_DELAY, LONGEST_DELAY, STABLE},
    robot::RestartPolicy,
};

/// The restarts of one program so far.
#[derive(Clone, Debug)]
pub(super) struct Restarts {
    policy: RestartPolicy,
    most: u32,
    used: u32,
}

/// The decision about a program that has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// It is started again after this time, and has so many further restarts left.
    Again(Duration, u32),
    /// It is done.
    Done,
    /// It has failed for good.
    Failed,
    /// It has no restart left.
    GaveUp,
}

impl Restarts {
    pub(super) const fn new(policy: RestartPolicy, most: u32) -> Self {
        Self {
            policy,
            most,
            used: 0,
        }
    }

    /// Decides about a program that ran for this time.
    pub(super) fn decide(&mut self, is_success: bool, ran: Duration) -> Next {
        if ran >= STABLE {
            self.used = 0;
        }
        match (self.policy, is_success) {
            (RestartPolicy::Never | RestartPolicy::OnFailure, true) => return Next::Done,
            (RestartPolicy::Never, false) => return Next::Failed,
            (RestartPolicy::OnFailure, false) | (RestartPolicy::Always, _) => {}
        }
        if self.used >= self.most {
            return Next::GaveUp;
        }
        // A delay that is no longer doubled has reached its limit long before.
        let delay = FIRST_DELAY * 2_u32.pow(self.used.min(16));
        self.used += 1;
        Next::Again(delay.min(LONGEST_DELAY), self.most - self.used)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Duration = Duration::from_secs(1);

    #[test]
    fn the_policy_decides_which_ends_are_followed_by_a_start() {
        use RestartPolicy::{Always, Never, OnFailure};
        let again = Next::Again(FIRST_DELAY, 2);
        for (policy, is_success, next) in [
            (Never, true, Next::Done),
            (Never, false, Next::Failed),
            (OnFailure, true, Next::Done),
            (OnFailure, false, again),
            (Always, true, again),
            (Always, false, again),
        ] {
            let decided = Restarts::new(policy, 3).decide(is_success, SHORT);
            assert_eq!(decided, next, "{policy:?} {is_success}");
        }
    }

    #[test]
    fn delays_double_up_to_a_limit_and_restarts_end() {
        let mut restarts = Restarts::new(RestartPolicy::Always, 7);
        let decide = |_| restarts.decide(false, SHORT);
        let decided: Vec<_> = (0..8).map(decide).collect();
        let ms = [500, 1_000, 2_000, 4_000, 8_000, 10_000, 10_000];
        let again = |(used, ms)| Next::Again(Duration::from_millis(ms), 6 - used);
        let expected = (0_u32..).zip(ms).map(again).chain([Next::GaveUp]);
        assert_eq!(decided, expected.collect::<Vec<_>>());
    }

    #[test]
    fn a_program_that_ran_long_starts_over() {
        let mut restarts = Restarts::new(RestartPolicy::OnFailure, 2);
        restarts.decide(false, SHORT);
        restarts.decide(false, SHORT);
        let just_short = STABLE - Duration::from_nanos(1);
        assert_eq!(restarts.clone().decide(false, just_short), Next::GaveUp);
        assert_eq!(restarts.decide(false, STABLE), Next::Again(FIRST_DELAY, 1));
    }

    #[test]
    fn no_number_of_restarts_overflows_the_delay() {
        let mut restarts = Restarts::new(RestartPolicy::Always, u32::MAX);
        for _ in 0..100 {
            restarts.decide(true, SHORT);
        }
        let next = restarts.decide(true, SHORT);
        assert!(matches!(next, Next::Again(LONGEST_DELAY, _)), "{next:?}");
    }
}
