//! The congestion controller for radio links: it sends at the delivery rate, and little faster.
//!
//! Radio links lose datagrams at random. A controller that treats each loss as a full queue (RFC 9002,
//! RFC 9438) stalls on them. This one measures the delivery rate and the minimum RTT, as BBR does, and keeps
//! their product in flight plus a short queue. It differs from BBR in two ways: it never waits for a probe
//! that the link does not answer, and it bounds its queue by time, so that the newest data can be sent soon.
//! Loss that occurs while there is no queue is random loss: the window grows by the same share.
//!
//! | phase | window | until |
//! | --- | --- | --- |
//! | start | doubles with each round | three rounds were no faster, or half was lost |
//! | cruise | rate x (min RTT + queue) | nine rounds |
//! | probe | a quarter more | one round |
//! | drain | rate x min RTT x 3/4 | one round |
//!
//! A round is a round trip, 10 ms at least. Data that is sent in one round is acknowledged, or lost, in the
//! next.
//!
//! Over a link of 15 ms with 4 % loss, cubic and reno use a seventh of its rate (`cargo test --release -p sm2-io
//! --features slow --test io_slow -- quic_link:: --nocapture`, in virtual time). This controller uses such a link even
//! at 30 % loss.

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

/// The queue at the bottleneck, which keeps the link busy.
const QUEUE: Duration = Duration::from_millis(8);
/// The shortest round.
const ROUND_MIN: Duration = Duration::from_millis(10);
/// The delivery rate is the maximum of this many rounds.
const RATE_ROUNDS: usize = 12;
/// The minimum RTT is that of this time.
const MIN_RTT_WINDOW: Duration = Duration::from_secs(10);
/// Rounds of a cruise after its first one.
const CRUISE_ROUNDS: u32 = 8;
/// After this many rounds of the start that were no faster, the link is full.
const FULL_ROUNDS: u32 = 3;
/// A greater share of loss than this, beyond random loss, means a full queue.
const CONGESTION_LOSS: f64 = 0.2;
/// A greater share of loss than this is never random.
const RANDOM_LOSS_MAX: f64 = 0.5;
/// The weight of a new sample of random loss in the average.
const RANDOM_LOSS_WEIGHT: f64 = 0.25;
/// The smallest window, in datagrams.
const WINDOW_MIN: u64 = 8;

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
    /// The delivery rates of the last rounds in bytes per second, the newest last.
    rates: VecDeque<u64>,
    /// The minima of the last halves of [`MIN_RTT_WINDOW`] and when each half began, the newest last.
    min_rtts: VecDeque<(Instant, Duration)>,
    /// The newest RTT sample.
    rtt: Duration,
    /// The share of data that is lost without a queue; `None` before the first sample.
    random_loss: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Start { best: u64, slow: u32 },
    Cruise { left: u32 },
    Probe,
    Drain,
}

/// The reports of the connection since the round began.
#[derive(Clone, Copy, Debug)]
struct Round {
    begin: Instant,
    acked: u64,
    lost: u64,
    /// Whether the application had less to send than the window allowed.
    app_limited: bool,
}

impl Round {
    const fn new(begin: Instant) -> Self {
        Self {
            begin,
            acked: 0,
            lost: 0,
            app_limited: false,
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
            min_rtts: VecDeque::new(),
            rtt: ROUND_MIN,
            random_loss: None,
        }
    }

    /// The delivery rate in bytes per second.
    fn rate(&self) -> u64 {
        self.rates.iter().copied().max().unwrap_or(0)
    }

    /// The minimum round-trip time, measured with an empty queue.
    fn min_rtt(&self) -> Duration {
        let min_rtt = self.min_rtts.iter().map(|(_, min_rtt)| *min_rtt).min();
        min_rtt.unwrap_or(self.rtt)
    }

    fn add_rtt_sample(&mut self, now: Instant, rtt: Duration) {
        self.rtt = rtt;
        match self.min_rtts.back_mut() {
            Some((since, min_rtt)) if now - *since < MIN_RTT_WINDOW / 2 => {
                *min_rtt = rtt.min(*min_rtt);
            }
            _ => self.min_rtts.push_back((now, rtt)),
        }
        while self.min_rtts.len() > 2 {
            self.min_rtts.pop_front();
        }
    }

    /// As [`on_ack`](Controller::on_ack), which tests cannot call: they cannot make an [`RttEstimator`].
    fn add_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool) {
        self.add_rtt_sample(now, now.saturating_duration_since(sent));
        self.round.acked += bytes;
        self.round.app_limited |= app_limited;
    }

    /// The bytes in flight that make a queue of this length, including those that random loss takes.
    fn in_flight(&self, queue: Duration) -> u64 {
        let time = (self.min_rtt() + queue).as_secs_f64();
        let arriving = 1.0 - self.random_loss.unwrap_or(0.0);
        // The conversion saturates; no real rate and time come close to that.
        (self.rate() as f64 * time / arriving) as u64
    }

    /// Adds the share of loss of a round that reports on data sent without a queue.
    fn add_random_loss_sample(&mut self, lost: f64) {
        let lost = lost.min(RANDOM_LOSS_MAX);
        let random_loss = self.random_loss.get_or_insert(lost);
        *random_loss += (lost - *random_loss) * RANDOM_LOSS_WEIGHT;
    }

    fn end_round(&mut self, now: Instant) {
        let Round {
            begin,
            acked,
            lost,
            app_limited,
        } = self.round;
        let rate = (acked as f64 / (now - begin).as_secs_f64()) as u64;
        self.round = Round::new(now);
        let lost = lost as f64 / (acked + lost).max(1) as f64;
        if matches!(
            self.phase,
            Phase::Cruise {
                left: CRUISE_ROUNDS
            }
        ) {
            // Reports on the data of the drain phase, which left no queue.
            self.add_random_loss_sample(lost);
        }
        let is_congested = lost > self.random_loss.unwrap_or(0.0) + CONGESTION_LOSS;
        // App-limited rounds give no bandwidth sample, unless they were faster than all others.
        if !app_limited || rate > self.rate() {
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
            Phase::Start { .. } if lost > RANDOM_LOSS_MAX => Phase::Drain,
            start @ Phase::Start { .. } if app_limited => start,
            Phase::Start { best, slow } if slow + 1 < FULL_ROUNDS => Phase::Start {
                best,
                slow: slow + 1,
            },
            Phase::Start { .. } => Phase::Drain,
            Phase::Cruise { left: 0 } => Phase::Probe,
            Phase::Cruise { left } => Phase::Cruise { left: left - 1 },
            Phase::Probe => Phase::Drain,
            Phase::Drain => Phase::Cruise {
                left: CRUISE_ROUNDS,
            },
        };
        let window = match self.phase {
            Phase::Start { slow: 0, .. } if !app_limited => self.window.saturating_mul(2),
            Phase::Start { .. } => self.window,
            Phase::Cruise { .. } => self.in_flight(QUEUE),
            Phase::Probe => {
                let in_flight = self.in_flight(QUEUE);
                in_flight + in_flight / 4
            }
            Phase::Drain => self.in_flight(Duration::ZERO) * 3 / 4,
        };
        self.window = window.max(WINDOW_MIN * self.mtu);
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
        self.add_ack(now, sent, bytes, app_limited);
    }

    fn on_end_acks(
        &mut self,
        now: Instant,
        _in_flight: u64,
        _app_limited: bool,
        _largest: Option<u64>,
    ) {
        let length = self.rtt.max(ROUND_MIN);
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
            // Nothing arrived for a long time: the path has changed, or was interrupted.
            *self = Self::new(now, u16::try_from(self.mtu).unwrap_or(u16::MAX));
        }
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.mtu = u64::from(new_mtu);
        self.window = self.window.max(WINDOW_MIN * self.mtu);
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

#[cfg(test)]
mod tests;
