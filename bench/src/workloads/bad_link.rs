//! The paper's figure 2: a camera, a local subscriber, and a remote one that joins over a bad link.
//!
//! 1 MB at 30 Hz is eight times the capacity of the link, so most messages cannot cross it. The case
//! measures how many do, how old they are on arrival, and whether the local subscriber is disturbed.
//! Messages of 100 kB are four fifths of the capacity, so all of them can cross.

use std::{ops::Range, time::Duration};

use sm2_lossy_link::Profile;

use super::{Case, Figure, Options, figure};
use crate::{
    clock::now_ns,
    job::{Arrival, Channel, Outcome, ProcessEvent, Read, Role, Side, Stream, Watch},
    link::Link,
    peers::{PeerInfo, Reach},
    stats::Durations,
    world::{Failure, ProcessId, TIMEOUT, World},
};

/// The length of the paper's messages, in bytes.
const LEN: usize = 1_000_000;

/// The length of messages that the link can carry at `RATE_HZ`, in bytes.
const SHORT_LEN: usize = 100_000;

/// Messages per second.
const RATE_HZ: f64 = 30.0;

/// The duration of the first part, with only the local subscriber.
const ALONE: Duration = Duration::from_secs(2);

/// The time from the start of the remote subscriber to the second part.
const SETTLE: Duration = Duration::from_secs(3);

/// The time that subscribers have for the last messages after the publisher has stopped.
const DRAIN: Duration = Duration::from_millis(300);

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    let wifi = Profile {
        pauses: Vec::new(),
        ..Profile::wifi()
    };
    let lossless = Profile {
        loss_permille: 0,
        ..wifi.clone()
    };
    let mut cases = vec![
        case(options, "lossless", lossless, LEN, 8.0),
        case(options, "wifi", wifi.clone(), LEN, 8.0),
        case(options, "wifi-100kB", wifi, SHORT_LEN, 8.0),
    ];
    if options.pauses {
        // Long enough to contain a long pause.
        cases.push(case(options, "wifi-pauses", Profile::wifi(), LEN, 36.0));
    }
    cases
}

fn case(
    options: &Options,
    label: &'static str,
    profile: Profile,
    len: usize,
    seconds: f64,
) -> Box<dyn Case> {
    Box::new(LossyLinkCase {
        label,
        profile,
        len,
        seconds: options.seconds.unwrap_or(seconds),
        read: options.read,
    })
}

struct LossyLinkCase {
    label: &'static str,
    profile: Profile,
    /// The length of each message, in bytes.
    len: usize,
    seconds: f64,
    read: Read,
}

impl Case for LossyLinkCase {
    fn label(&self) -> String {
        self.label.to_owned()
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        let link = Link::new(&self.profile)?;
        let mut world = World::across(peer, &link)?;
        let seen = self.play(peer, &mut world)?;
        Ok([
            seen.remote_figures(self.len, self.profile.rate_bit),
            seen.local_figures(),
            vec![
                figure("torn", "messages", seen.torn() as f64),
                figure("cpu_near", "%", seen.cpu_percent),
            ],
        ]
        .concat())
    }
}

impl LossyLinkCase {
    fn play(&self, peer: &PeerInfo, world: &mut World) -> Result<Seen, Failure> {
        let has_local = peer.reach != Reach::LinkAlone;
        let channel = Channel {
            name: "bench/camera".to_owned(),
            max_len: self.len,
            // Only the newest message is of interest: a second one in the queue is a frame older.
            depth: 1,
            lossless: false,
            subscribers: usize::from(has_local),
        };
        let stream = Stream {
            channel: channel.clone(),
            len: self.len,
            rate_hz: Some(RATE_HZ),
            warm_up_s: 0.5,
            // The director sends `stop`.
            seconds: 3_600.0,
            stamped: true,
        };
        let watcher = |number| Role::Watcher {
            channel: channel.clone(),
            read: self.read,
            number,
        };
        let publisher = world.start("publisher", Role::Publisher(stream))?;
        world.ready(publisher)?;
        let local = match has_local {
            true => Some(world.start("local", watcher(0))?),
            false => None,
        };
        if let Some(local) = local {
            world.ready(local)?;
        }
        world.send_word(publisher, "go");
        world.expect(publisher, &ProcessEvent::Measuring, "publish", TIMEOUT)?;
        let before = timed(|| world.let_run(ALONE))?;
        let remote = world.start_at(Side::Far, "remote", watcher(1))?;
        world.ready(remote)?;
        world.let_run(SETTLE)?;
        let cpu_before = world.cpu_ns_at(Side::Near)?;
        let after = timed(|| world.let_run(Duration::from_secs_f64(self.seconds)))?;
        let cpu_ns = world.cpu_ns_at(Side::Near)?.saturating_sub(cpu_before);
        world.send_word(publisher, "stop");
        world.expect(publisher, &ProcessEvent::Measured, "stop", TIMEOUT)?;
        world.outcome(publisher, TIMEOUT)?;
        world.let_run(DRAIN)?;
        Ok(Seen {
            cpu_percent: cpu_ns as f64 / (after.end - after.start) as f64 * 100.0,
            local: local.map(|local| watched(world, local)).transpose()?,
            remote: watched(world, remote)?,
            before,
            after,
        })
    }
}

/// Runs `work`, and returns its start and end on the clock of the messages' times.
fn timed(work: impl FnOnce() -> Result<(), Failure>) -> Result<Range<u64>, Failure> {
    let start_ns = now_ns();
    work()?;
    Ok(start_ns..now_ns())
}

fn watched(world: &mut World, watcher: ProcessId) -> Result<Watch, Failure> {
    world.end(watcher);
    match world.outcome(watcher, TIMEOUT)? {
        Outcome::Watched(watch) => Ok(watch),
        _ => Ok(Watch::default()),
    }
}

/// The results of one run.
struct Seen {
    local: Option<Watch>,
    remote: Watch,
    /// The first part, with only the local subscriber.
    before: Range<u64>,
    /// The second part, with both subscribers.
    after: Range<u64>,
    /// The CPU time of all near processes, in percent of one core.
    cpu_percent: f64,
}

impl Seen {
    fn torn(&self) -> u64 {
        self.remote.torn + self.local.as_ref().map_or(0, |local| local.torn)
    }

    /// The figures of the remote subscriber.
    fn remote_figures(&self, len: usize, rate_bit: f64) -> Vec<Figure> {
        let hz = self.remote.hz(&self.after);
        let goodput_bit = hz * len as f64 * 8.0;
        let mut figures = vec![
            figure("remote_goodput", "Mbit/s", goodput_bit / 1e6),
            figure(
                "remote_share",
                "% of the link",
                goodput_bit / rate_bit * 100.0,
            ),
            figure("remote_hz", "Hz", hz),
        ];
        let ages = self
            .remote
            .durations(&self.after, |it| it.in_hand_ns - it.handed_ns);
        let ages = ages.spread();
        // Without messages, there are no ages.
        if ages.count > 0 {
            figures.extend([
                figure("remote_age_p50", "ms", ages.p50 / 1e6),
                figure("remote_age_p99", "ms", ages.p99 / 1e6),
            ]);
        }
        figures
    }

    /// The figures of the local subscriber, if there is one.
    fn local_figures(&self) -> Vec<Figure> {
        let Some(local) = &self.local else {
            return Vec::new();
        };
        let p99_ms = |span| {
            let latencies = local.durations(span, |it| it.read_ns - it.start_ns);
            latencies.spread().p99 / 1e6
        };
        let dropped = local.missing(&(self.before.start..self.after.end));
        vec![
            figure("local_hz_before", "Hz", local.hz(&self.before)),
            figure("local_hz_after", "Hz", local.hz(&self.after)),
            figure("local_latency_p99_before", "ms", p99_ms(&self.before)),
            figure("local_latency_p99_after", "ms", p99_ms(&self.after)),
            figure("local_dropped", "messages", dropped as f64),
        ]
    }
}

impl Watch {
    /// The messages that arrived within a span.
    fn within<'a>(&'a self, span: &'a Range<u64>) -> impl Iterator<Item = &'a Arrival> {
        let came = |it: &&Arrival| span.contains(&it.in_hand_ns);
        self.arrivals.iter().filter(came)
    }

    fn hz(&self, span: &Range<u64>) -> f64 {
        self.within(span).count() as f64 * 1e9 / (span.end - span.start) as f64
    }

    fn durations(&self, span: &Range<u64>, of: impl Fn(&Arrival) -> u64) -> Durations {
        let mut durations = Durations::default();
        self.within(span).for_each(|it| durations.record(of(it)));
        durations
    }

    /// The number of messages that are missing between the first and the last one of a span.
    fn missing(&self, span: &Range<u64>) -> u64 {
        let mut numbers: Vec<_> = self.within(span).map(|it| it.number).collect();
        numbers.sort_unstable();
        numbers.dedup();
        match (numbers.first(), numbers.last()) {
            (Some(first), Some(last)) => last - first + 1 - numbers.len() as u64,
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(numbers: &[u64]) -> Watch {
        let arrival = |&number: &u64| Arrival {
            number,
            start_ns: number * 1_000_000_000,
            handed_ns: number * 1_000_000_000 + 1_000_000,
            in_hand_ns: number * 1_000_000_000 + 301_000_000,
            read_ns: number * 1_000_000_000 + 303_000_000,
        };
        Watch {
            arrivals: numbers.iter().map(arrival).collect(),
            torn: 1,
        }
    }

    fn value(figures: &[Figure], name: &str) -> Option<f64> {
        let found = figures.iter().find(|figure| figure.name == name);
        found.map(|figure| figure.value)
    }

    #[test]
    fn figures_are_of_their_own_part_of_the_stream() {
        let seen = Seen {
            local: Some(watch(&[0, 1, 2, 3, 5, 7, 8])),
            remote: watch(&[4, 6]),
            before: 0..2_000_000_000,
            after: 4_000_000_000..9_000_000_000,
            cpu_percent: 0.0,
        };
        let remote = seen.remote_figures(LEN, 32e6);
        assert_eq!(value(&remote, "remote_hz"), Some(0.4));
        assert_eq!(value(&remote, "remote_goodput"), Some(3.2));
        assert_eq!(value(&remote, "remote_share"), Some(10.0));
        assert_eq!(value(&remote, "remote_age_p99"), Some(300.0));
        let local = seen.local_figures();
        assert_eq!(value(&local, "local_hz_before"), Some(1.0));
        assert_eq!(value(&local, "local_hz_after"), Some(0.6));
        assert_eq!(value(&local, "local_latency_p99_after"), Some(303.0));
        assert_eq!(value(&local, "local_dropped"), Some(2.0));
        assert_eq!(seen.torn(), 2);
    }

    #[test]
    fn what_does_not_come_has_no_age_and_who_is_not_there_no_figures() {
        let seen = Seen {
            local: None,
            remote: Watch::default(),
            before: 0..1,
            after: 1..2,
            cpu_percent: 0.0,
        };
        let remote = seen.remote_figures(LEN, 32e6);
        assert_eq!(value(&remote, "remote_goodput"), Some(0.0));
        assert_eq!(value(&remote, "remote_age_p50"), None);
        assert_eq!(seen.local_figures(), []);
    }
}
