//! How fast a program takes messages: a fast one does not read the clock for each.
//!
//! The time when a message was taken is needed for its delay alone, and a reading costs as much as a fifth of what a
//! short message costs its receiver. So calls in quick succession, each of which finds a message at once, use one
//! reading for up to [`ROW`] messages. A program that becomes slow meanwhile is noticed at the next tick of the kernel,
//! some milliseconds later: the clock of these ticks is read without an instruction that waits.

use sm2_proto::Instant;

/// How many messages are taken with one reading of the clock.
const ROW: u8 = 16;

/// How long each message of a row took at most, in nanoseconds, when the next ones need no readings.
const FAST_NS: u64 = 2_000;

/// The pace of one interface.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// The last reading of the clock.
    read: Instant,
    /// The time of the last tick at that reading.
    tick: Instant,
    /// How many calls found a message at once since then.
    found: u8,
    /// How many calls may still use that reading.
    left: u8,
}

impl Pace {
    /// Whether the next message may be taken with the last reading. `last_tick` reads the clock of the ticks.
    #[inline]
    pub(super) fn goes_on(&mut self, last_tick: impl FnOnce() -> Instant) -> bool {
        if self.left == 0 {
            return false;
        }
        self.left -= 1;
        self.tick == last_tick()
    }

    /// Notes a reading of the clock.
    #[inline]
    pub(super) fn read(&mut self, now: Instant, last_tick: impl FnOnce() -> Instant) {
        let passed = now.0.saturating_sub(self.read.0);
        let is_fast = self.found > 0 && passed <= FAST_NS * u64::from(self.found);
        self.left = if is_fast { ROW } else { 0 };
        if is_fast {
            self.tick = last_tick();
        }
        (self.read, self.found) = (now, 0);
    }

    /// Notes that a call found a message at once.
    #[inline]
    pub(super) const fn found(&mut self) {
        self.found = self.found.saturating_add(1);
    }

    /// Notes that a call found none.
    #[inline]
    pub(super) const fn ended(&mut self) {
        (self.found, self.left) = (0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Instant = Instant(5);

    /// The pace of a program that took one message in this time, and has read the clock since.
    fn after(ns: u64) -> Pace {
        let mut pace = Pace::default();
        pace.read(Instant(1_000), || TICK);
        pace.found();
        pace.read(Instant(1_000 + ns), || TICK);
        pace
    }

    #[test]
    fn a_fast_program_reads_the_clock_once_for_a_row_of_messages() {
        let mut pace = after(FAST_NS);
        for message in 0..3 * ROW {
            assert!(pace.goes_on(|| TICK), "message {message}");
            pace.found();
            if message % ROW == ROW - 1 {
                assert!(!pace.goes_on(|| TICK));
                pace.read(Instant(pace.read.0 + u64::from(ROW) * FAST_NS), || TICK);
            }
        }
    }

    #[test]
    fn a_slow_program_reads_the_clock_for_each_message() {
        assert!(!after(FAST_NS + 1).goes_on(|| TICK));
        let mut pace = after(1);
        assert!(pace.goes_on(|| TICK));
        pace.read(Instant(2_000), || TICK);
        assert!(!pace.goes_on(|| TICK), "no message was found");
    }

    #[test]
    fn a_row_ends_with_a_tick_and_with_a_call_that_finds_nothing() {
        let mut pace = after(1);
        assert!(!pace.goes_on(|| Instant(TICK.0 + 1)));
        assert!(pace.goes_on(|| TICK));
        pace.ended();
        assert!(!pace.goes_on(|| TICK));
    }
}
