//! The time to the first message from a random time on in a long bag.
//!
//! Each search has a process of its own, which removes the bag from the page cache, opens it, and reads one message.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use sm2_bag::{Bag, Filter};

use super::{
    Case, Figure, Options, figure,
    recording::{FRAMES, Load, Rig},
};
use crate::{
    disk,
    job::{Outcome, Role, Seek, Sought},
    payload::scattered,
    peers::PeerInfo,
    stats::Durations,
    world::{Failure, TIMEOUT, World},
};

/// The length of the bag by default, in GB.
const GIGABYTES: f64 = 20.0;

/// The number of random times.
const TIMES: u64 = 50;

pub(super) fn cases(options: &Options) -> Vec<Box<dyn Case>> {
    let gigabytes = options.gigabytes.unwrap_or(GIGABYTES);
    vec![Box::new(SeekCase {
        load: Load::new(options.size, gigabytes, options.frame_rate),
        folder: options.folder.clone(),
    })]
}

struct SeekCase {
    load: Load,
    folder: Option<PathBuf>,
}

impl Case for SeekCase {
    fn label(&self) -> String {
        String::new()
    }

    fn run(&self, peer: &'static PeerInfo) -> Result<Vec<Figure>, Failure> {
        let folder = disk::scratch(self.folder.as_deref(), self.load.bytes())?;
        let file = folder.path().join("bag.mcap");
        let mut world = World::new(peer)?;
        let rig = Rig::start(&mut world, &self.load, Some(&file), true)?;
        rig.go(&mut world);
        let done = rig.finish(&mut world)?;
        drop(world);
        let mut world = World::new(peer)?;
        let times = times(&file)?;
        let any = self.search(&mut world, &file, &times, None)?;
        let frame = self.search(&mut world, &file, &times, Some(FRAMES))?;
        let bytes = done.recorded.map_or(0, |it| it.file_bytes);
        let of = |all: &[Sought], of: fn(&Sought) -> u64| {
            let mut durations = Durations::default();
            all.iter().for_each(|it| durations.record(of(it)));
            durations.spread()
        };
        let (opened, first) = (of(&any, |it| it.open_ns), of(&any, |it| it.first_ns));
        let frames = of(&frame, |it| it.first_ns);
        let both = || any.iter().chain(&frame);
        let peak = both().map(|it| it.peak_bytes).max().unwrap_or_default();
        Ok(vec![
            figure("first_message_p50", "ms", first.p50 / 1e6),
            figure("first_message_max", "ms", first.max / 1e6),
            figure("first_frame_p50", "ms", frames.p50 / 1e6),
            figure("first_frame_max", "ms", frames.max / 1e6),
            figure("open_p50", "ms", opened.p50 / 1e6),
            figure("open_max", "ms", opened.max / 1e6),
            figure("peak_rss", "MB", peak as f64 / 1e6),
            figure(
                "fetched_mean",
                "MB",
                of(&any, |it| it.fetched_bytes).mean / 1e6,
            ),
            figure("bag", "GB", bytes as f64 / 1e9),
        ])
    }
}

impl SeekCase {
    /// Searches the first message from each of the times on.
    fn search(
        &self,
        world: &mut World,
        file: &Path,
        times: &[u64],
        topic: Option<&str>,
    ) -> Result<Vec<Sought>, Failure> {
        let mut all = Vec::new();
        for at_ns in times {
            let seek = Seek {
                file: file.to_owned(),
                at_ns: *at_ns,
                topic: topic.map(str::to_owned),
            };
            let seeker = world.start("seeker", Role::Seeker(seek))?;
            if let Outcome::Sought(sought) = world.outcome(seeker, TIMEOUT)? {
                all.push(sought);
            }
            world.end(seeker);
        }
        Ok(all)
    }
}

/// Times that are spread over the bag at random, the same ones for equal bags. A frame follows each of them.
fn times(file: &Path) -> Result<Vec<u64>, Failure> {
    let bag = Bag::open(file).map_err(Failure::content)?;
    let report = bag.report();
    let (start, end) = report.start_ns.zip(report.end_ns).unwrap_or_default();
    let span = (last_frame(&bag, start, end)? - start).max(1);
    let at = |number| start + scattered(number) % span;
    Ok((0..TIMES).map(at).collect())
}

/// The time of the last frame. The small messages go on until the frames before it are on the disk.
fn last_frame(bag: &Bag, start: u64, end: u64) -> Result<u64, Failure> {
    let mut before_ns = 1_000_000_000;
    loop {
        let filter = Filter {
            from_ns: Some(end.saturating_sub(before_ns)),
            topics: BTreeSet::from([FRAMES.to_owned()]),
            ..Filter::default()
        };
        let frames = bag.messages(&filter);
        match frames.last().transpose().map_err(Failure::content)? {
            Some(frame) => return Ok(frame.log_time),
            None if before_ns > end - start => return Ok(start),
            None => before_ns *= 2,
        }
    }
}
