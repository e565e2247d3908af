//! How fast a connection sends: as fast as bytes arrive, and little faster.
//!
//! Radio links lose datagrams at random. A controller that takes each loss for a queue that is full
//! (RFC 9002, RFC 9438) stands still on them. This one measures, as BBR does, how many bytes arrive in a
//! second and how long the way takes when nobody waits on it, and keeps as much under way as those two
//! say, and a short queue more. What is different from BBR: it never waits for a probe to end that the link
//! does not answer, and the queue that it makes is bounded by time, so that what is newest can be sent
//! soon. What is lost while there is no queue is lost by chance: so much more is kept under way.
//!
//! | phase | window | until |
//! | --- | --- | --- |
//! | start | doubles with each round | it was no faster for three rounds, or half was lost |
//! | cruise | rate x (shortest way + queue) | eight rounds |
//! | probe | a quarter more | one round |
//! | drain | rate x shortest way x 3/4 | one round |
//!
//! A round is a round trip, 10 ms at least. What was sent in one is acknowledged, or lost, in the next.

use std::{
    any::Any,
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use quinn_proto::{
    RttEstimator,
    congestion::{Controller, ControllerFactory},
};

/// The queue that it makes on the way, so that the link is never idle.
const QUEUE: Duration = Duration::from_millis(8);
/// The shortest round.
const ROUND: Duration = Duration::from_millis(10);
/// How many rounds the fastest of them counts.
const RATE_ROUNDS: usize = 12;
/// How long the shortest way counts.
const WAY: Duration = Duration::from_secs(10);
/// Rounds between two probes.
const CRUISE: u32 = 8;
/// Rounds of the start that were no faster: the link is full.
const FULL: u32 = 3;
/// More than this part of what was sent in a round was lost, beside chance: it is a queue.
const QUEUE_LOSS: f64 = 0.2;
/// More is never chance.
const CHANCE_MAX: f64 = 0.5;
/// What a measured chance weighs beside those before.
const CHANCE_WEIGHT: f64 = 0.25;
/// Never less is under way, in datagrams.
const LEAST: u64 = 8;

/// Makes controllers of this kind.
#[derive(Clone, Copy, Debug, Default)]
pub struct SteadyConfig;

impl ControllerFactory for SteadyConfig {
    fn build(self: Arc<Self>, now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        Box::new(Steady::new(now, current_mtu))
    }
}

/// The controller of one connection.
#[derive(Clone, Debug)]
struct Steady {
    mtu: u64,
    window: u64,
    phase: Phase,
    round: Round,
    /// Bytes each second, of the last rounds, the newest last.
    rates: VecDeque<u64>,
    /// The shortest ways of the last halves of [`WAY`], the newest last.
    ways: VecDeque<(Instant, Duration)>,
    /// The last that was measured.
    rtt: Duration,
    /// Which part of what is sent is lost by chance, as far as it was measured.
    chance: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Start { best: u64, slow: u32 },
    Cruise { left: u32 },
    Probe,
    Drain,
}

/// What was seen since it began.
#[derive(Clone, Copy, Debug)]
struct Round {
    begin: Instant,
    acked: u64,
    lost: u64,
    /// Whether there was less to be sent than might have been.
    idle: bool,
}

impl Round {
    const fn new(begin: Instant) -> Self {
        Self {
            begin,
            acked: 0,
            lost: 0,
            idle: false,
        }
    }
}

impl Steady {
    fn new(now: Instant, mtu: u16) -> Self {
        let mtu = u64::from(mtu);
        Self {
            mtu,
            window: mtu * 10,
            phase: Phase::Start { best: 0, slow: 0 },
            round: Round::new(now),
            rates: VecDeque::new(),
            ways: VecDeque::new(),
            rtt: ROUND,
            chance: None,
        }
    }

    /// Bytes each second.
    fn rate(&self) -> u64 {
        self.rates.iter().copied().max().unwrap_or(0)
    }

    /// When nobody waits on it.
    fn way(&self) -> Duration {
        let shortest = self.ways.iter().map(|(_, way)| *way).min();
        shortest.unwrap_or(self.rtt)
    }

    fn note_way(&mut self, now: Instant, way: Duration) {
        self.rtt = way;
        match self.ways.back_mut() {
            Some((since, shortest)) if now - *since < WAY / 2 => *shortest = way.min(*shortest),
            _ => self.ways.push_back((now, way)),
        }
        while self.ways.len() > 2 {
            self.ways.pop_front();
        }
    }

    /// What is under way if the queue takes so long, with what will not arrive.
    fn under_way(&self, queue: Duration) -> u64 {
        let time = (self.way() + queue).as_secs_f64();
        let arriving = 1.0 - self.chance.unwrap_or(0.0);
        // Not above what a rate and a time of this world make.
        (self.rate() as f64 * time / arriving) as u64
    }

    /// In a round that tells what became of what was sent without a queue.
    fn note_chance(&mut self, lost: f64) {
        let lost = lost.min(CHANCE_MAX);
        let chance = self.chance.get_or_insert(lost);
        *chance += (lost - *chance) * CHANCE_WEIGHT;
    }

    fn end_round(&mut self, now: Instant) {
        let Round {
            begin,
            acked,
            lost,
            idle,
        } = self.round;
        let rate = (acked as f64 / (now - begin).as_secs_f64()) as u64;
        self.round = Round::new(now);
        let lost = lost as f64 / (acked + lost).max(1) as f64;
        if matches!(self.phase, Phase::Cruise { left: CRUISE }) {
            self.note_chance(lost);
        }
        let is_congested = lost > self.chance.unwrap_or(0.0) + QUEUE_LOSS;
        // What was not asked of the link says nothing of it, unless it was more than before.
        if !idle || rate > self.rate() {
            self.rates.push_back(rate);
        }
        let kept = if is_congested { 2 } else { RATE_ROUNDS };
        while self.rates.len() > kept {
            self.rates.pop_front();
        }
        self.phase = match self.phase {
            Phase::Start { best, .. } if rate > best + best / 4 => Phase::Start {
                best: rate,
                slow: 0,
            },
            Phase::Start { .. } if lost > CHANCE_MAX => Phase::Drain,
            start @ Phase::Start { .. } if idle => start,
            Phase::Start { best, slow } if slow + 1 < FULL => Phase::Start {
                best,
                slow: slow + 1,
            },
            Phase::Start { .. } => Phase::Drain,
            Phase::Cruise { left: 0 } => Phase::Probe,
            Phase::Cruise { left } => Phase::Cruise { left: left - 1 },
            Phase::Probe => Phase::Drain,
            Phase::Drain => Phase::Cruise { left: CRUISE },
        };
        let window = match self.phase {
            Phase::Start { slow: 0, .. } if !idle => self.window.saturating_mul(2),
            Phase::Start { .. } => self.window,
            Phase::Cruise { .. } => self.under_way(QUEUE),
            Phase::Probe => {
                let more = self.under_way(QUEUE);
                more + more / 4
            }
            Phase::Drain => self.under_way(Duration::ZERO) * 3 / 4,
        };
        self.window = window.max(LEAST * self.mtu);
    }
}

impl Controller for Steady {
    fn on_ack(
        &mut self,
        now: Instant,
        sent: Instant,
        bytes: u64,
        app_limited: bool,
        _rtt: &RttEstimator,
    ) {
        self.note_way(now, now.saturating_duration_since(sent));
        self.round.acked += bytes;
        self.round.idle |= app_limited;
    }

    fn on_end_acks(
        &mut self,
        now: Instant,
        _in_flight: u64,
        _app_limited: bool,
        _largest: Option<u64>,
    ) {
        let length = self.rtt.max(ROUND);
        if now.saturating_duration_since(self.round.begin) >= length {
            self.end_round(now);
        }
    }

    fn on_congestion_event(
        &mut self,
        now: Instant,
        _sent: Instant,
        is_persistent_congestion: bool,
        lost_bytes: u64,
    ) {
        self.round.lost += lost_bytes;
        if is_persistent_congestion {
            // Nothing arrived for long: the way is another one, or was gone.
            *self = Self::new(now, u16::try_from(self.mtu).unwrap_or(u16::MAX));
        }
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.mtu = u64::from(new_mtu);
        self.window = self.window.max(LEAST * self.mtu);
    }

    fn window(&self) -> u64 {
        self.window
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }

    fn initial_window(&self) -> u64 {
        10 * self.mtu
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}
