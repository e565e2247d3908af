//! The pace of a replay.

use std::time::Duration;

use sm2_proto::Instant;

/// The recorded time that a replay has reached at a moment, and its speed from there on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    at: Instant,
    time: u64,
    /// 0 is as fast as possible; `None` while the replay is paused.
    rate: Option<f64>,
}

impl Pace {
    pub(super) const fn new(now: Instant, time: u64, rate: Option<f64>) -> Self {
        Self {
            at: now,
            time,
            rate,
        }
    }

    pub(super) const fn rate(&self) -> Option<f64> {
        self.rate
    }

    /// The moment when a message of this time is due. `None` while the replay is paused.
    pub(super) fn due(&self, time: u64) -> Option<Instant> {
        let rate = self.rate?;
        if rate == 0.0 {
            return Some(self.at);
        }
        let left = time.saturating_sub(self.time) as f64 / rate;
        Some(self.at.after(Duration::from_nanos(left as u64)))
    }

    /// The recorded time that the replay has reached. At the greatest speed and during a pause, that is the time of
    /// [`reach`](Self::reach).
    pub(super) fn time(&self, now: Instant) -> u64 {
        let passed = now.since(self.at).as_nanos() as f64 * self.rate.unwrap_or(0.0);
        self.time.saturating_add(passed as u64)
    }

    /// By how many nanoseconds the recorded time advances in a second.
    pub(super) fn ns_per_s(&self) -> u64 {
        (self.rate.unwrap_or(0.0) * 1e9) as u64
    }

    /// Goes on from the present time at another speed.
    pub(super) fn set_rate(&mut self, now: Instant, rate: Option<f64>) {
        *self = Self::new(now, self.time(now), rate);
    }

    /// Sets the replay to `time`, which the clock does not tell: at the greatest speed, and after a step
    /// during a pause.
    pub(super) fn reach(&mut self, now: Instant, time: u64) {
        *self = Self::new(now, self.time.max(time), self.rate);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: Instant = Instant(1_000);

    #[test]
    fn a_message_is_due_at_its_age_by_the_rate() {
        for (rate, due) in [(1.0, 1_400), (2.0, 1_200), (0.5, 1_800), (0.0, 1_000)] {
            let pace = Pace::new(START, 70, Some(rate));
            assert_eq!(pace.due(470), Some(Instant(due)), "{rate}");
            assert_eq!(pace.due(10), Some(START), "{rate}");
        }
    }

    #[test]
    fn a_pause_shifts_the_messages_after_it() {
        let mut pace = Pace::new(START, 0, Some(2.0));
        pace.set_rate(Instant(1_100), None);
        assert_eq!((pace.due(300), pace.ns_per_s()), (None, 0));
        assert_eq!(pace.time(Instant(9_000)), 200);
        pace.set_rate(Instant(5_000), Some(2.0));
        assert_eq!(pace.due(300), Some(Instant(5_050)));
        assert_eq!(pace.ns_per_s(), 2_000_000_000);
        pace.set_rate(Instant(5_025), Some(1.0));
        assert_eq!(pace.due(300), Some(Instant(5_075)));
    }

    #[test]
    fn a_step_moves_a_pause_forwards() {
        let mut pace = Pace::new(START, 0, None);
        pace.reach(Instant(2_000), 500);
        // A message that was late does not move the time back.
        pace.reach(Instant(2_000), 400);
        pace.set_rate(Instant(3_000), Some(1.0));
        assert_eq!(pace.due(600), Some(Instant(3_100)));
    }

    #[test]
    fn the_greatest_speed_goes_on_from_the_last_message() {
        let mut pace = Pace::new(START, 0, Some(0.0));
        pace.reach(Instant(1_500), 900);
        pace.set_rate(Instant(2_000), Some(1.0));
        assert_eq!(pace.due(1_000), Some(Instant(2_100)));
    }
}
