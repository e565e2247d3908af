//! Timers with their callbacks.

use std::time::Duration;

use sm2_proto::clock::DomainTime;

use crate::clock::{Clock, DomainTimer};
use crate::executor::Failure;
use crate::{Instant, Tick};

type OnTick<'a, S> = Box<dyn FnMut(&mut S, Tick, DomainTime) -> Result<(), Failure> + 'a>;

/// The timers of a node, in the order in which they were made.
pub(super) struct Ticks<'a, S> {
    timers: Vec<(DomainTimer, OnTick<'a, S>)>,
}

impl<S> Default for Ticks<'_, S> {
    fn default() -> Self {
        Self { timers: Vec::new() }
    }
}

impl<'a, S> Ticks<'a, S> {
    pub(super) fn add(&mut self, period: Duration, clock: &Clock, on_tick: OnTick<'a, S>) {
        self.timers.push((clock.every(period), on_tick));
    }

    /// Starts all timers again at this time.
    pub(super) fn restart(&mut self, now: DomainTime) {
        for (timer, _) in &mut self.timers {
            timer.restart(now);
        }
    }

    /// Starts timers again whose time has jumped back.
    pub(super) fn follow(&mut self, clock: &Clock) {
        for (timer, _) in &mut self.timers {
            timer.follow(clock);
        }
    }

    /// The time of the next tick.
    pub(super) fn next(&self) -> Option<DomainTime> {
        self.timers
            .iter()
            .filter_map(|(timer, _)| timer.next())
            .min()
    }

    /// The moment of the next tick, as far as it is known now.
    pub(super) fn deadline(&mut self, clock: &Clock) -> Option<Instant> {
        let deadlines = self.timers.iter_mut();
        deadlines
            .filter_map(|(timer, _)| timer.deadline(clock))
            .min()
    }

    /// Handles the next tick that is due, if there is one: the earliest one, and for one time that of the timer that
    /// was made first.
    pub(super) fn handle_next(&mut self, state: &mut S, now: DomainTime) -> Result<bool, Failure> {
        let timers = self.timers.iter_mut();
        let waiting = timers.filter(|(timer, _)| timer.next().is_some());
        let first = waiting.min_by_key(|(timer, _)| timer.next());
        let Some((timer, on_tick)) = first else {
            return Ok(false);
        };
        match timer.handle(now) {
            Some(tick) => on_tick(state, tick, now).map(|()| true),
            None => Ok(false),
        }
    }
}
