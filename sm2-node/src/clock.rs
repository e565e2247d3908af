//! Domain time: the wall clock on a robot, the time of the messages in a replay or a simulation.

use std::cell::Cell;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

pub use sm2_proto::clock::{ClockReading, DomainTime};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::driver::{Condition, SharedInterface};
use crate::wait_set::Source;
use crate::{
    DeclareError, Instant, Message, MissedTicks, Node, PublishError, Publisher, RecvError,
    Subscriber, Tick, Timer,
};

/// The topic of readings.
pub const TOPIC: &str = "clock";

/// A reading on its topic.
//= SM2-CLK-001
#[derive(Clone, Copy, Debug, Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sm2/Clock")]
#[repr(C)]
struct ClockMessage {
    time_ns: u64,
    at_ns: u64,
    ns_per_s: u64,
}

impl From<ClockReading> for ClockMessage {
    fn from(reading: ClockReading) -> Self {
        Self {
            time_ns: reading.time.0,
            at_ns: reading.at.0,
            ns_per_s: reading.ns_per_s,
        }
    }
}

impl From<ClockMessage> for ClockReading {
    fn from(message: ClockMessage) -> Self {
        Self {
            time: DomainTime(message.time_ns),
            at: Instant(message.at_ns),
            ns_per_s: message.ns_per_s,
        }
    }
}

/// The domain time of a node ([`Node::clock`]).
///
/// On a robot it is the wall clock. If the domain has a source of time, such as a simulator with a [`ClockSource`], it
/// follows that source, through its pauses and jumps, and at its speed. Deadlines, leases and timeouts of SM2 do not
/// follow it.
///
/// A clock is for one thread at a time; each thread that needs the time gets one of its own. Before the node has
/// received the first reading, a source that exists counts as absent: the time can jump once after the start of the
/// node.
///
/// ```no_run
/// use std::time::Duration;
/// use sm2_node::Node;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let node = Node::new("filter")?;
/// let clock = node.clock()?;
/// let mut timer = clock.every(Duration::from_millis(100));
/// loop {
///     let tick = timer.sleep(&clock)?;
///     println!("tick {} at {} ns", tick.number, clock.now().0);
/// }
/// # }
/// ```
#[derive(Debug)]
pub struct Clock {
    readings: Subscriber<ClockMessage>,
    /// The reading that was received last. The cell keeps two threads from using the clock at the same time: one could
    /// take the reading that the other sleeps for.
    reading: Cell<Option<ClockReading>>,
}

/// The longest sleep by the wall clock, which can be set meanwhile.
const WALL_SLEEP_MAX: Duration = Duration::from_secs(1);

impl Node {
    /// Subscribes to the domain's time.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn clock(&self) -> Result<Clock, DeclareError> {
        let readings = self.subscriber_builder(TOPIC).depth(1).declare()?;
        Ok(Clock {
            readings,
            reading: Cell::new(None),
        })
    }
}

impl Clock {
    /// The domain time now, in nanoseconds since 1970 (UTC).
    #[must_use]
    pub fn now(&self) -> DomainTime {
        let reading = self.reading();
        reading.map_or_else(wall_time, |it| it.time(crate::now()))
    }

    /// The reading that rules the time; `None` if the node has received none, so that the wall clock does.
    //= SM2-CLK-003
    #[must_use]
    pub fn reading(&self) -> Option<ClockReading> {
        // After an error, the readings so far stay in force.
        while let Ok(Some(sample)) = self.readings.try_recv() {
            self.reading.set(Some((*sample).into()));
        }
        self.reading.get()
    }

    /// The moment of the monotonic clock when domain time reaches `time`, as far as it is known now. `None` if it
    /// stands still before that.
    #[must_use]
    pub fn instant(&self, time: DomainTime) -> Option<Instant> {
        let _ = self.reading();
        self.known_instant(time)
    }

    /// As [`instant`](Self::instant), by the reading that was received last.
    fn known_instant(&self, time: DomainTime) -> Option<Instant> {
        match self.reading.get() {
            Some(reading) => reading.instant(time),
            None => Some(crate::now().after(time.since(wall_time()))),
        }
    }

    /// Waits for the next reading, but not after `due`.
    fn wait(&self, due: Option<Instant>) -> Result<(), RecvError> {
        let sample = match due.map(|it| it.since(crate::now())) {
            None => Some(self.readings.recv()?),
            Some(left) if self.reading.get().is_some() => self.readings.recv_timeout(left)?,
            Some(left) => self.readings.recv_timeout(left.min(WALL_SLEEP_MAX))?,
        };
        if let Some(sample) = sample {
            self.reading.set(Some((*sample).into()));
        }
        Ok(())
    }

    /// Returns a timer that ticks once in each period of domain time. The first tick is due one period from now.
    #[must_use]
    pub fn every(&self, period: Duration) -> DomainTimer {
        let now = self.now();
        DomainTimer {
            period,
            missed: MissedTicks::default(),
            timer: timer(now, period, MissedTicks::default()),
            last: now,
        }
    }
}

/// A [`WaitSet`](crate::WaitSet) with a clock reports each reading; the deadlines of timers may have changed then.
impl Source for Clock {
    fn interface(&self) -> &Arc<SharedInterface> {
        self.readings.interface()
    }

    fn condition(&self) -> Condition {
        self.readings.condition()
    }
}

/// The time of the wall clock, which is domain time in a domain without a source.
#[must_use]
pub fn wall_time() -> DomainTime {
    let wall = SystemTime::now().duration_since(UNIX_EPOCH);
    let ns = wall.unwrap_or_default().as_nanos();
    DomainTime(u64::try_from(ns).unwrap_or(u64::MAX))
}

/// A timer of domain time, whose monotonic deadlines are moments of domain time in nanoseconds.
fn timer(start: DomainTime, period: Duration, missed: MissedTicks) -> Timer {
    Timer::starting_at(Instant(start.0), period).missed_ticks(missed)
}

/// Ticks at regular moments of domain time ([`Clock::every`]). Its methods need a clock of its domain, which can be
/// that of another thread than the one that made the timer.
///
/// Tick number `n` is due `n` periods after the start, as with a [`Timer`]. No tick is due while domain time stands
/// still. After domain time has jumped back, the ticks start again from the new time, with number 1.
///
/// The field `due` of a [`Tick`] is a moment of domain time here.
#[derive(Clone, Debug)]
pub struct DomainTimer {
    period: Duration,
    missed: MissedTicks,
    /// Its moments are domain time.
    timer: Timer,
    /// The domain time that was seen last.
    last: DomainTime,
}

impl DomainTimer {
    /// Sets what happens to missed ticks; [`MissedTicks::Skip`] by default.
    #[must_use]
    pub fn missed_ticks(self, missed: MissedTicks) -> Self {
        Self {
            missed,
            timer: self.timer.missed_ticks(missed),
            ..self
        }
    }

    /// The moment of the monotonic clock when the next tick is due, as far as it is known now. `None` while domain
    /// time stands still before that. Another reading of the clock can change it: add the clock to the
    /// [`WaitSet`](crate::WaitSet) that waits until then.
    pub fn deadline(&mut self, clock: &Clock) -> Option<Instant> {
        self.follow(clock);
        self.known_deadline(clock)
    }

    fn known_deadline(&self, clock: &Clock) -> Option<Instant> {
        clock.known_instant(self.next()?)
    }

    /// The domain time of the next tick. `None` for a time beyond the range of a clock.
    pub(crate) fn next(&self) -> Option<DomainTime> {
        let due = self.timer.deadline()?;
        (due.0 != u64::MAX).then_some(DomainTime(due.0))
    }

    /// Returns the tick that is due at `now`, if one is, and goes on to the next one.
    pub(crate) fn handle(&mut self, now: DomainTime) -> Option<Tick> {
        self.timer.handle(Instant(now.0))
    }

    /// Starts again at `now`.
    pub(crate) fn restart(&mut self, now: DomainTime) {
        self.timer = timer(now, self.period, self.missed);
        self.last = now;
    }

    /// Returns the tick that is due, if one is, and goes on to the next one.
    pub fn try_tick(&mut self, clock: &Clock) -> Option<Tick> {
        let now = self.follow(clock);
        self.handle(now)
    }

    /// Sleeps until the next tick is due.
    ///
    /// # Errors
    ///
    /// [`RecvError::Shutdown`], [`RecvError::Io`].
    pub fn sleep(&mut self, clock: &Clock) -> Result<Tick, RecvError> {
        loop {
            if let Some(tick) = self.try_tick(clock) {
                return Ok(tick);
            }
            clock.wait(self.known_deadline(clock))?;
        }
    }

    /// Starts again if domain time has jumped back, and returns the time.
    pub(crate) fn follow(&mut self, clock: &Clock) -> DomainTime {
        let now = clock.now();
        if now < self.last {
            self.restart(now);
        }
        self.last = now;
        now
    }
}

/// Publishes domain time: for simulators and players. A domain has one source at a time.
///
/// Dropping the source leaves the nodes with its last reading.
#[derive(Debug)]
pub struct ClockSource {
    readings: Publisher<ClockMessage>,
}

impl ClockSource {
    /// Declares the source. Nodes follow it from the first [`set`](Self::set) on.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    //= SM2-CLK-001
    pub fn new(node: &Node) -> Result<Self, DeclareError> {
        let readings = node
            .publisher_builder(TOPIC)
            .depth(1)
            .latched(1)
            .declare()?;
        Ok(Self { readings })
    }

    /// Sets domain time to `time` now, from where it advances by `ns_per_s` nanoseconds per second: 0 stops it, and
    /// 1,000,000,000 is real time.
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub fn set(&self, time: DomainTime, ns_per_s: u64) -> Result<ClockReading, PublishError> {
        let reading = ClockReading {
            time,
            at: crate::now(),
            ns_per_s,
        };
        self.readings.publish(&reading.into())?;
        Ok(reading)
    }

    /// How many subscribers the source has in the domain, and how many of them are linked.
    #[must_use]
    pub fn listeners(&self) -> (usize, usize) {
        let links = self.readings.links();
        let open = links.iter().filter(|it| it.open).count();
        (self.readings.matched(), open)
    }
}
