//! The meaning of the signals that `sm2 up` gets.

use sm2_proto::Instant;

use super::limits::SECOND_SIGNAL;
use crate::interrupt::Stopped;

/// The signals so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Signals {
    first_at: Option<Instant>,
    second: Option<Stopped>,
}

/// The reaction to a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// End the programs in order.
    Stop,
    /// End them at once.
    Kill,
}

impl Signals {
    /// Takes a signal. One that follows the first one closely is the same: the terminal and a program such as
    /// `timeout` may both pass on one Ctrl-C.
    pub(super) fn take(&mut self, now: Instant, signal: Stopped) -> Option<Order> {
        match self.first_at {
            None => {
                self.first_at = Some(now);
                Some(Order::Stop)
            }
            Some(first) if now.since(first) < SECOND_SIGNAL => None,
            Some(_) => {
                self.second = Some(signal);
                Some(Order::Kill)
            }
        }
    }

    pub(super) const fn is_stopping(&self) -> bool {
        self.first_at.is_some()
    }

    /// The signal that killed the programs.
    pub(super) const fn second(&self) -> Option<Stopped> {
        self.second
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_signal_that_is_passed_on_twice_is_one() {
        let interrupt = Stopped::from_number(2).unwrap();
        let start = Instant(1_000);
        let mut signals = Signals::default();
        assert!(!signals.is_stopping());
        assert_eq!(signals.take(start, interrupt), Some(Order::Stop));
        let soon = start.after(SECOND_SIGNAL - Duration::from_nanos(1));
        assert_eq!(signals.take(soon, interrupt), None);
        assert!(signals.is_stopping() && signals.second().is_none());
        let later = start.after(SECOND_SIGNAL);
        assert_eq!(signals.take(later, interrupt), Some(Order::Kill));
        assert_eq!(signals.second(), Some(interrupt));
    }
}
