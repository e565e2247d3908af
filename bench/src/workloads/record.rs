//! Recording frames and small messages to a disk, beside a subscriber that has nothing to do with them.
//!
//! A run has three parts:
//!
//! 1. The recorder records all frames as fast as it can.
//! 2. A process writes as many bytes to the same folder without a middleware. The disk of a shared machine changes its
//!    speed, so a ratio needs both in one run.
//! 3. The same publishers run without a recorder, paced as they were with it. The unconcerned subscriber then has the
//!    same load beside it, but nothing of the recorder and its disk.

use std::{ops::Range, path::PathBuf};

use super::{
    Case, Figure, Options, figure,
    recording::{Done, FRAMES, Load, Rig, ready, write_blocks},
};
use crate::{
    clock::now_ns,
    disk,
    job::{Channel, Outcome, Read, Recorded, Role, Stream},
    peers::PeerInfo,
    recorded::Content,
    stats::{Durations, Spread},
    world::{Failure, ProcessId, TIMEOUT, World},
};

/// The amount of data of each recording by default, in GB.
const GIGABYTES: f64 = 4.0;

/// The name of the peer without a recorder.
const RAW: &str = "raw-disk";

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    let gigabytes = options.gigabytes.unwrap_or(GIGABYTES);
    vec![Box::new(Record {
        load: Load::new(options.size, gigabytes, options.frame_rate),
        folder: options.folder.clone(),
    })]
}

struct Record {
    load: Load,
    folder: Option<PathBuf>,
}

impl Case for Record {
    fn label(&self) -> String {
        String::new()
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        // The recorded file and the file of the disk's own speed are there at the same time.
        let bytes = self.load.bytes().saturating_mul(2);
        let folder = disk::scratch(self.folder.as_deref(), bytes)?;
        let (file, raw) = (folder.path().join("bag.mcap"), folder.path().join("raw"));
        let mut world = World::new(peer)?;
        let with = match peer.name {
            RAW => self.without_recorder(&mut world, &file)?,
            _ => self.with_recorder(&mut world, &file)?,
        };
        let disk = write_blocks(&mut world, &self.load, &raw)?;
        drop(world);
        let content = match peer.name {
            RAW => None,
            _ => Some(Content::of(&file).map_err(Failure::content)?),
        };
        drop(folder);
        let mut world = World::new(peer)?;
        let without = self.paced(&mut world, &with, peer.name != RAW)?;
        Ok([
            with.speed(&self.load, content.as_ref(), disk.as_ref()),
            with.losses(content.as_ref()),
            latencies(&with.latency_ns, &without),
        ]
        .concat())
    }
}

impl Record {
    fn with_recorder(&self, world: &mut World, file: &PathBuf) -> Result<Recording, Failure> {
        let tap = Tap::start(world)?;
        let rig = Rig::start(world, &self.load, Some(file), true)?;
        tap.go(world);
        rig.go(world);
        let done = rig.finish(world)?;
        let span = span(&done);
        Ok(Recording {
            latency_ns: tap.finish(world, &span)?,
            span,
            done,
        })
    }

    /// A process that writes blocks stands in for the frames and their recorder.
    fn without_recorder(&self, world: &mut World, file: &PathBuf) -> Result<Recording, Failure> {
        let tap = Tap::start(world)?;
        let rig = Rig::start(world, &self.load, None, false)?;
        tap.go(world);
        rig.go(world);
        let recorded = write_blocks(world, &self.load, file)?;
        let done = Done {
            recorded,
            ..rig.finish(world)?
        };
        let span = span(&done);
        Ok(Recording {
            latency_ns: tap.finish(world, &span)?,
            span,
            done,
        })
    }

    /// The latency of the unconcerned subscriber without a recorder, for as long as the recording took.
    fn paced(
        &self,
        world: &mut World,
        with: &Recording,
        has_frames: bool,
    ) -> Result<Spread, Failure> {
        let tap = Tap::start(world)?;
        let load = Load {
            rate_hz: Some(self.load.count as f64 / with.seconds()),
            ..self.load.clone()
        };
        let rig = Rig::start(world, &load, None, has_frames)?;
        tap.go(world);
        rig.go(world);
        let start_ns = now_ns();
        if !has_frames {
            world.let_run(std::time::Duration::from_secs_f64(with.seconds()))?;
        }
        rig.finish(world)?;
        tap.finish(world, &(start_ns..now_ns()))
    }
}

/// The time from the first frame until the file was complete and on the disk.
fn span(done: &Done) -> Range<u64> {
    let recorded = done.recorded.map(|it| it.start_ns..it.done_ns);
    let recorded = recorded.unwrap_or_default();
    let start_ns = done.framed.map_or(recorded.start, |it| it.start_ns);
    start_ns..recorded.end.max(start_ns + 1)
}

/// The subscriber of a topic that is not recorded, and its publisher.
struct Tap {
    publisher: ProcessId,
    watcher: ProcessId,
}

impl Tap {
    fn start(world: &mut World) -> Result<Self, Failure> {
        let channel = Channel {
            name: "bench/other".to_owned(),
            max_len: 64,
            depth: 8,
            lossless: false,
            subscribers: 1,
        };
        let stream = Stream {
            channel: channel.clone(),
            len: 64,
            rate_hz: Some(1_000.0),
            warm_up_s: 0.5,
            // The director sends `stop`.
            seconds: 3_600.0,
            stamped: true,
        };
        let publisher = ready(world, "publisher", Role::Publisher(stream))?;
        let watcher = Role::Watcher {
            channel,
            read: Read::Full,
            number: 0,
        };
        let watcher = ready(world, "watcher", watcher)?;
        Ok(Self { publisher, watcher })
    }

    fn go(&self, world: &mut World) {
        world.send_word(self.publisher, "go");
    }

    /// The latencies of the messages that arrived within the span.
    fn finish(&self, world: &mut World, span: &Range<u64>) -> Result<Spread, Failure> {
        world.send_word(self.publisher, "stop");
        // The lines before the outcome say where its own parts begin and end.
        while !matches!(
            world.next_event(self.publisher, "stop", TIMEOUT)?,
            crate::job::ProcessEvent::Done(_)
        ) {}
        world.end(self.watcher);
        let mut latencies = Durations::default();
        if let Outcome::Watched(watch) = world.outcome(self.watcher, TIMEOUT)? {
            let came = watch.arrivals.iter();
            came.filter(|it| span.contains(&it.in_hand_ns))
                .for_each(|it| latencies.record(it.read_ns - it.start_ns));
        }
        Ok(latencies.spread())
    }
}

/// The results of the first part of a run.
struct Recording {
    done: Done,
    span: Range<u64>,
    latency_ns: Spread,
}

impl Recording {
    fn seconds(&self) -> f64 {
        (self.span.end - self.span.start) as f64 / 1e9
    }

    /// The speed, also that of the disk alone, and the CPU time of the recorder.
    fn speed(
        &self,
        load: &Load,
        content: Option<&Content>,
        disk: Option<&Recorded>,
    ) -> Vec<Figure> {
        let Some(recorded) = &self.done.recorded else {
            return Vec::new();
        };
        let bytes = content.map_or(recorded.file_bytes, |it| it.bytes) as f64;
        let written = bytes / self.seconds();
        let cpu_s = recorded.cpu_ns as f64 / 1e9;
        let mut figures = vec![
            figure("written", "MB/s", written / 1e6),
            figure("recorder_cpu", "%", cpu_s / self.seconds() * 100.0),
            figure("cpu_at_1GBps", "%", cpu_s / bytes * 1e11),
        ];
        if let Some(disk) = disk {
            let seconds = (disk.done_ns - disk.start_ns) as f64 / 1e9;
            let raw = disk.file_bytes as f64 / seconds;
            figures.push(figure("disk_alone", "MB/s", raw / 1e6));
            figures.push(figure("ratio_to_disk", "times", written / raw));
        }
        if let Some(framed) = &self.done.framed {
            let frames_s = (framed.end_ns - framed.start_ns) as f64 / 1e9;
            let blocked = framed.blocked_ns as f64 / 1e9 / frames_s;
            figures.push(figure("publisher_blocked", "%", blocked * 100.0));
            figures.push(figure("frames", "Hz", load.count as f64 / self.seconds()));
        }
        figures
    }

    /// The published messages that are not in the file.
    fn losses(&self, content: Option<&Content>) -> Vec<Figure> {
        let (Some(content), Some(framed)) = (content, &self.done.framed) else {
            return Vec::new();
        };
        let small = self.done.small.iter();
        let missing = small
            .clone()
            .map(|(name, count)| content.missing(name, *count));
        let published: u64 = small.map(|it| it.1).sum();
        let frames = content.missing(FRAMES, framed.count);
        vec![
            figure("frames_lost", "messages", frames as f64),
            figure("small_lost", "messages", missing.sum::<u64>() as f64),
            figure("small_published", "messages", published as f64),
            figure("torn", "messages", content.torn as f64),
        ]
    }
}

/// The latencies of the unconcerned subscriber. Nothing if it has received nothing.
fn latencies(with: &Spread, without: &Spread) -> Vec<Figure> {
    if with.count == 0 || without.count == 0 {
        return Vec::new();
    }
    vec![
        figure("other_p50_with", "us", with.p50 / 1e3),
        figure("other_p50_without", "us", without.p50 / 1e3),
        figure("other_p99_with", "us", with.p99 / 1e3),
        figure("other_p99_without", "us", without.p99 / 1e3),
        figure("other_p99_ratio", "times", with.p99 / without.p99),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Framed;

    fn value(figures: &[Figure], name: &str) -> Option<f64> {
        let found = figures.iter().find(|figure| figure.name == name);
        found.map(|figure| figure.value)
    }

    fn recording() -> Recording {
        let done = Done {
            framed: Some(Framed {
                count: 400,
                start_ns: 1_000_000_000,
                end_ns: 4_500_000_000,
                blocked_ns: 700_000_000,
            }),
            recorded: Some(Recorded {
                start_ns: 0,
                done_ns: 5_000_000_000,
                cpu_ns: 400_000_000,
                file_bytes: 4_000_000_000,
            }),
            small: vec![("small".to_owned(), 7)],
        };
        Recording {
            span: span(&done),
            done,
            latency_ns: Spread::default(),
        }
    }

    #[test]
    fn the_speed_is_that_of_a_complete_file() {
        let recording = recording();
        let disk = Recorded {
            start_ns: 0,
            done_ns: 2_000_000_000,
            cpu_ns: 1,
            file_bytes: 4_000_000_000,
        };
        let load = Load::new(10_000_000, 4.0, None);
        let figures = recording.speed(&load, None, Some(&disk));
        assert_eq!(value(&figures, "written"), Some(1_000.0));
        assert_eq!(value(&figures, "ratio_to_disk"), Some(0.5));
        assert_eq!(value(&figures, "recorder_cpu"), Some(10.0));
        assert_eq!(value(&figures, "cpu_at_1GBps"), Some(10.0));
        assert_eq!(value(&figures, "publisher_blocked"), Some(20.0));
    }

    #[test]
    fn what_is_not_in_the_file_is_lost() {
        let figures = recording().losses(Some(&Content::default()));
        assert_eq!(value(&figures, "frames_lost"), Some(400.0));
        assert_eq!(value(&figures, "small_lost"), Some(7.0));
        assert_eq!(recording().losses(None), []);
    }

    #[test]
    fn a_latency_needs_both_parts() {
        let spread = |p99| Spread {
            count: 1,
            p99,
            ..Spread::default()
        };
        let figures = latencies(&spread(3e3), &spread(2e3));
        assert_eq!(value(&figures, "other_p99_ratio"), Some(1.5));
        assert_eq!(latencies(&spread(3e3), &Spread::default()), []);
    }
}
