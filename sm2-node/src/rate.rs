//! A loop that runs at a regular rate.

use std::os::fd::AsFd;
use std::thread;
use std::time::Duration;

use sm2_io::wait_readable;

use crate::{MissedTicks, Shutdown, Tick, Timer};

/// A loop that runs at a regular rate, in a thread that waits for nothing else: a [`Timer`] that puts the thread to
/// sleep.
///
/// ```
/// use std::time::Duration;
/// use sm2_node::Rate;
///
/// let mut rate = Rate::every(Duration::from_micros(100));
/// for _ in 0..3 {
///     rate.sleep();
///     // Work that may take different times: the ticks stay where they are.
/// }
/// ```
///
/// A loop that also handles messages uses a [`WaitSet`](crate::WaitSet) or an [`Executor`](crate::Executor)
/// with a timer instead.
#[derive(Clone, Debug)]
pub struct Rate {
    timer: Timer,
}

impl Rate {
    /// Runs once in each period. The first [`sleep`](Self::sleep) ends one period from now.
    #[must_use]
    pub fn every(period: Duration) -> Self {
        Timer::every(period).into()
    }

    /// Runs `frequency` times in each second.
    #[must_use]
    pub fn hz(frequency: u32) -> Self {
        Timer::hz(frequency).into()
    }

    /// Sets what happens to missed ticks; [`MissedTicks::Skip`] by default.
    #[must_use]
    pub fn missed_ticks(self, missed: MissedTicks) -> Self {
        self.timer.missed_ticks(missed).into()
    }

    /// Runs `frequency` times in each second from now on: for a frequency that is a
    /// [parameter](crate::params). If the rate has another one, it begins anew, with tick 1. Else nothing changes, so a
    /// loop can call this in each run.
    ///
    /// ```no_run
    /// use sm2_node::{Node, Rate};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// let node = Node::new("camera")?;
    /// let mut parameters = node.parameters_builder();
    /// let rate_hz = parameters.parameter("rate_hz", 30).range(1..=120).add();
    /// let _parameters = parameters.declare()?;
    /// let mut rate = Rate::hz(30);
    /// loop {
    ///     rate.set_hz(rate_hz.get() as u32);
    ///     rate.sleep();
    ///     // Take an image.
    /// }
    /// # }
    /// ```
    pub fn set_hz(&mut self, frequency: u32) {
        self.timer.set_hz(frequency, sm2_io::clock::now());
    }

    /// Sleeps until the next tick is due. If it is due already, returns at once. After the only tick of a timer that
    /// does not repeat, never returns.
    pub fn sleep(&mut self) -> Tick {
        loop {
            match self.tick_or_pause() {
                Ok(tick) => return tick,
                Err(pause) => thread::sleep(pause),
            }
        }
    }

    /// As [`sleep`](Self::sleep), but ends early, with `None`, when the shutdown is requested.
    pub fn sleep_unless(&mut self, shutdown: &Shutdown) -> Option<Tick> {
        loop {
            if shutdown.is_requested() {
                return None;
            }
            match self.tick_or_pause() {
                Ok(tick) => return Some(tick),
                Err(pause) => {
                    // The kernel may have no memory for the call; a sleep needs none.
                    if wait_readable(&[shutdown.as_fd()], Some(pause)).is_err() {
                        thread::sleep(pause.min(Duration::from_millis(1)));
                    }
                }
            }
        }
    }

    /// The tick that is due, or the time until the next one.
    fn tick_or_pause(&mut self) -> Result<Tick, Duration> {
        let now = sm2_io::clock::now();
        let due = self.timer.handle(now);
        due.ok_or_else(|| match self.timer.deadline() {
            Some(deadline) => deadline.since(now),
            None => Duration::MAX,
        })
    }
}

/// For a start or a schedule that [`Timer`] alone offers.
impl From<Timer> for Rate {
    fn from(timer: Timer) -> Self {
        Self { timer }
    }
}
