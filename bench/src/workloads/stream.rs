//! A publisher and its subscribers: the common part of figures 3 to 5 of the paper and of throughput.

use std::{
    thread,
    time::{Duration, Instant},
};

use super::{Figure, figure};
use crate::{
    job::{Channel, MemoryWork, Outcome, ProcessEvent, Read, Reception, Role, Stream},
    peers::PeerInfo,
    world::{Failure, TIMEOUT, World},
};

/// The time that subscribers have for the last messages after the publisher has stopped.
const DRAIN: Duration = Duration::from_millis(300);

/// The number of memory measurements while messages flow.
const LOOKS: usize = 5;

/// A stream and its subscribers.
#[derive(Clone, Debug)]
pub(super) struct Setting {
    pub(super) len: usize,
    pub(super) subscribers: usize,
    pub(super) rate_hz: Option<f64>,
    pub(super) seconds: f64,
    pub(super) read: Read,
    pub(super) depth: usize,
    /// True if nothing may be dropped.
    pub(super) lossless: bool,
    /// True if messages carry the time of their publication.
    pub(super) stamped: bool,
}

/// The results of one run.
#[derive(Debug)]
pub(super) struct Run {
    /// The number of counted messages that were published.
    published: u64,
    receptions: Vec<Reception>,
    /// The CPU time of all processes, in percent of one core.
    cpu_percent: f64,
    /// The memory of all processes, in bytes.
    pss_bytes: f64,
}

/// Runs a stream once.
pub(super) fn run(peer: &'static PeerInfo, setting: &Setting) -> Result<Run, Failure> {
    let mut world = World::new(peer)?;
    let channel = Channel {
        name: "bench/stream".to_owned(),
        max_len: setting.len,
        depth: setting.depth,
        lossless: setting.lossless,
        subscribers: setting.subscribers,
    };
    let stream = Stream {
        channel: channel.clone(),
        len: setting.len,
        rate_hz: setting.rate_hz,
        warm_up_s: 0.5,
        seconds: setting.seconds,
        stamped: setting.stamped,
    };
    let publisher = world.start("publisher", Role::Publisher(stream))?;
    world.ready(publisher)?;
    let mut subscribers = Vec::new();
    for number in 0..setting.subscribers {
        let role = Role::Subscriber {
            channel: channel.clone(),
            read: setting.read,
            number,
        };
        subscribers.push(world.start(&format!("subscriber-{number}"), role)?);
    }
    for &subscriber in &subscribers {
        world.ready(subscriber)?;
    }
    world.send_word(publisher, "go");
    world.expect(
        publisher,
        &ProcessEvent::Measuring,
        "find its subscribers",
        TIMEOUT,
    )?;
    let (before, start) = (world.cpu_ns()?, Instant::now());
    let limit = TIMEOUT + Duration::from_secs_f64(setting.seconds);
    world.expect(publisher, &ProcessEvent::Measured, "publish", limit)?;
    let cpu_ns = world.cpu_ns()?.saturating_sub(before);
    let cpu_percent = cpu_ns as f64 / start.elapsed().as_nanos() as f64 * 100.0;
    let pss_bytes = memory(&world, setting)?;
    world.send_word(publisher, "stop");
    let published = match world.outcome(publisher, TIMEOUT)? {
        Outcome::Published { counted, .. } => counted,
        _ => 0,
    };
    thread::sleep(DRAIN);
    subscribers
        .iter()
        .for_each(|&subscriber| world.end(subscriber));
    let mut receptions = Vec::new();
    for subscriber in subscribers {
        if let Outcome::Received(reception) = world.outcome(subscriber, TIMEOUT)? {
            receptions.push(reception);
        }
    }
    Ok(Run {
        published,
        receptions,
        cpu_percent,
        pss_bytes,
    })
}

/// The mean of several measurements of memory, spread over the time between two messages.
fn memory(world: &World, setting: &Setting) -> Result<f64, Failure> {
    let apart = setting.rate_hz.map_or(0.02, |rate| 1.37 / rate).min(0.2);
    let mut sum = 0;
    for _ in 0..LOOKS {
        sum += world.pss_bytes()?;
        thread::sleep(Duration::from_secs_f64(apart));
    }
    Ok(sum as f64 / LOOKS as f64)
}

impl Run {
    fn mean(&self, of: impl Fn(&Reception) -> f64) -> f64 {
        let sum: f64 = self.receptions.iter().map(of).sum();
        sum / self.receptions.len().max(1) as f64
    }

    fn worst(&self, of: impl Fn(&Reception) -> f64) -> f64 {
        self.receptions.iter().map(of).fold(0.0, f64::max)
    }

    /// Received messages per second: the mean of all subscribers, and the slowest one.
    pub(super) fn rate(&self) -> Vec<Figure> {
        let slowest = self.receptions.iter().map(|reception| reception.hz);
        vec![
            figure("received_hz", "Hz", self.mean(|reception| reception.hz)),
            figure(
                "received_hz_slowest",
                "Hz",
                slowest.fold(f64::INFINITY, f64::min),
            ),
        ]
    }

    /// Messages that did not arrive, or that differ from the written ones.
    pub(super) fn losses(&self) -> Vec<Figure> {
        let received: u64 = self
            .receptions
            .iter()
            .map(|reception| reception.counted)
            .sum();
        let due = self.published * self.receptions.len() as u64;
        let dropped = due.saturating_sub(received) as f64 / due.max(1) as f64;
        let wrong = |of: fn(&Reception) -> u64| self.receptions.iter().map(of).sum::<u64>() as f64;
        vec![
            figure("dropped", "%", dropped * 100.0),
            figure("lost", "messages", due.saturating_sub(received) as f64),
            figure("torn", "messages", wrong(|reception| reception.torn)),
            figure("stale", "messages", wrong(|reception| reception.stale)),
        ]
    }

    /// Latency from the start of writing to the end of reading, and the peer's part of it: from
    /// publishing to receiving.
    pub(super) fn latency(&self) -> Vec<Figure> {
        let ms = |ns: f64| ns / 1e6;
        vec![
            figure("latency_mean", "ms", ms(self.mean(|r| r.latency_ns.mean))),
            figure("latency_p50", "ms", ms(self.mean(|r| r.latency_ns.p50))),
            figure("latency_p99", "ms", ms(self.worst(|r| r.latency_ns.p99))),
            figure("handover_p50", "ms", ms(self.mean(|r| r.handover_ns.p50))),
        ]
    }

    /// CPU time and memory.
    pub(super) fn costs(&self) -> Vec<Figure> {
        vec![
            figure("cpu", "%", self.cpu_percent),
            figure("pss", "MB", self.pss_bytes / 1e6),
        ]
    }
}

/// Measures the memory alone: the same writing and reading, on one thread per process of the stream
/// and at most one per core.
pub(super) fn memory_alone(
    peer: &'static PeerInfo,
    setting: &Setting,
) -> Result<(f64, crate::stats::Spread), Failure> {
    let mut world = World::new(peer)?;
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let work = MemoryWork {
        len: setting.len,
        readers: setting.subscribers,
        read: setting.read,
        threads: cores.min(setting.subscribers + 1),
        seconds: setting.seconds,
    };
    let process = world.start("memory", Role::Memory(work))?;
    let limit = TIMEOUT + Duration::from_secs_f64(setting.seconds);
    match world.outcome(process, limit)? {
        Outcome::Memory { hz, one_way_ns } => Ok((hz, one_way_ns)),
        _ => Ok((0.0, crate::stats::Spread::default())),
    }
}

#[cfg(test)]
mod tests {
    use super::Run;
    use crate::job::Reception;

    #[test]
    fn what_is_missing_of_all_that_was_due_is_dropped() {
        let reception = |counted, torn| Reception {
            counted,
            torn,
            hz: counted as f64,
            ..Reception::default()
        };
        let run = Run {
            published: 100,
            receptions: vec![reception(100, 0), reception(80, 3)],
            cpu_percent: 0.0,
            pss_bytes: 0.0,
        };
        let values: Vec<_> = run.losses().iter().map(|figure| figure.value).collect();
        assert_eq!(values, [10.0, 20.0, 3.0, 0.0]);
        let rates: Vec<_> = run.rate().iter().map(|figure| figure.value).collect();
        assert_eq!(rates, [90.0, 80.0]);
    }
}
