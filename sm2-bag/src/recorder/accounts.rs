//! The account of a recording, over random topics, limits, ends of publishers and of the recorder, full and slow
//! disks, and damaged bytes: for each topic, published = in the bag + gaps, or the topic is named as missing.
//!
//! `SM2_TEST_SEED` chooses the sample, and `SM2_ACCOUNTS` is the number of runs. A run that fails prints its own seed:
//! with that one and `SM2_ACCOUNTS=1`, it runs alone.

mod check;
mod disk;
mod random;
mod talkers;

use sm2_proto::control::{Limit, Limits};
use std::fs::File;
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use sm2_manager::Background;
use sm2_node::{Node, Shutdown};
use sm2_proto::Name;
use sm2_test_support::{SOON, memory, seed, until};

use self::disk::{Disk, Switch};
use self::random::Random;
use self::talkers::Talkers;
use super::{Options, Recorder, Step, Topics};
use crate::error::RecordError;
use crate::writer::Compression;

/// The number of runs, unless `SM2_ACCOUNTS` has one.
const RUNS: u64 = if cfg!(feature = "slow") { 300 } else { 12 };
/// A recorder has no more topics than this if the Manager lets it have few.
const FEW_INTERFACES: u32 = 2;
/// A step of the recorder takes no longer than this while nothing comes.
const STEP: Duration = Duration::from_millis(1);

/// A domain, a recorder whose disk the test controls, and publishers.
struct World<'a> {
    random: Random,
    folder: PathBuf,
    recorder: Recorder<'a>,
    topics: Topics,
    disk: Arc<Switch>,
    talkers: Talkers,
    /// Whether a full disk costs messages.
    waits: bool,
    /// Whether the disk has ended the recording.
    has_ended: bool,
}

#[test]
fn what_was_published_is_in_the_bag_or_its_gaps() {
    let number = |name| std::env::var(name).ok().and_then(|it| it.parse().ok());
    let first: u64 = seed();
    let runs = number("SM2_ACCOUNTS").unwrap_or(RUNS);
    for seed in first..first.saturating_add(runs) {
        let _context = Context(seed);
        run(seed);
    }
}

/// Prints the seed of a run that fails.
struct Context(u64);

impl Drop for Context {
    fn drop(&mut self) {
        if std::thread::panicking() {
            println!(
                "it fails alone with SM2_ACCOUNTS=1 SM2_TEST_SEED={}",
                self.0
            );
        }
    }
}

fn run(seed: u64) {
    let mut random = Random::new(seed);
    let folder = tempfile::tempdir_in(memory()).unwrap();
    let socket = folder.path().join("sock");
    // A busy machine may need long between the two steps of connecting a node.
    let mut limits = Limits::default().with(Limit::Greeting, SOON.as_millis() as u32);
    let are_few = random.one_in(6);
    if are_few {
        limits = limits.with(Limit::InterfacesPerSession, FEW_INTERFACES);
    }
    let manager = sm2_manager::Options {
        limits,
        ..Default::default()
    };
    let _manager = Background::start(&socket, manager).unwrap();
    let node = Node::builder("recorder").socket(&socket).connect().unwrap();
    let stop = Shutdown::new().unwrap();
    let file = File::create_new(folder.path().join("bag")).unwrap();
    let (disk, switch) = Disk::new(file);
    let talkers = Talkers::new(&socket, are_few);
    let options = options(&mut random, &talkers);
    let (topics, waits) = (options.topics.clone(), random.one_in(2));
    let recorder = Recorder::start(&node, disk, options, stop.as_fd()).unwrap();
    if waits {
        recorder.wait_for_room();
    }
    let mut world = World {
        random,
        folder: folder.path().to_owned(),
        recorder,
        topics,
        disk: switch,
        talkers,
        waits,
        has_ended: false,
    };
    for _ in 0..world.random.below(60) {
        world.act();
    }
    world.end();
}

/// The options of a recording.
fn options(random: &mut Random, talkers: &Talkers) -> Options {
    let topics = match random.below(2) {
        0 => Topics::All,
        _ => Topics::Named(talkers.topics().map(|it| Name::new(&it).unwrap()).collect()),
    };
    let reliable = talkers.reliable_topics();
    let reliable = reliable.map(|it| Name::new(&it).unwrap());
    Options {
        // A topic that the recorder does not find is not reliable for it.
        reliable: match random.one_in(2) {
            true => reliable.collect(),
            false => Default::default(),
        },
        budget_bytes: random.pick(&[2_000, 150_000, 1 << 20, 256 << 20]),
        max_len_bytes: random.pick(&[u64::MAX, u64::MAX, 50, 80_000]),
        sync_interval: Duration::from_millis(random.below(5) + 1),
        compression: random.pick(&[Compression::None, Compression::Lz4, Compression::Zstd]),
        min_free_bytes: 1_000,
        ..Options::new(topics)
    }
}

impl World<'_> {
    /// Something happens.
    fn act(&mut self) {
        if self.has_ended {
            return;
        }
        match self.random.below(14) {
            0 | 1 => self.begin_talker(),
            2..=6 => {
                let count = self.random.below(20) + 1;
                let len = self.random.pick(&[0, 40, 60, 3_000, 70_000, 150_000]);
                self.talkers.publish(&mut self.random, count, len);
            }
            7 => {
                // More than wait for the recorder.
                self.talkers.publish(&mut self.random, 100, 10);
            }
            8 | 9 => {
                for _ in 0..self.random.below(20) {
                    self.step();
                }
            }
            10 => self.talkers.end_one(&mut self.random),
            11 => self.disk.stall(self.random.one_in(2)),
            12 => {
                let is_full = self.random.one_in(3);
                self.disk.set_free(if is_full { 0 } else { u64::MAX });
            }
            _ => {
                // Without room on the disk, a recording that does not wait ends.
                let is_full = self.random.one_in(if self.waits { 2 } else { 8 });
                self.disk.fill(is_full, &mut self.random);
            }
        }
        self.step();
    }

    /// A publisher comes, and is linked unless the recorder has no room for its topic.
    fn begin_talker(&mut self) {
        if !self.talkers.begin(&mut self.random, &self.topics) {
            return;
        }
        // The recorder is not stalled while it looks for new topics.
        until("the publisher is linked, or never will be", || {
            self.step();
            self.has_ended
                || self.talkers.newest_is_linked()
                || self.recorder.progress().not_recorded > 0
        });
    }

    /// Records for a moment.
    fn step(&mut self) {
        if self.has_ended {
            return;
        }
        match self.recorder.step(STEP) {
            Ok(Step::DiskFull) => self.has_ended = true,
            Ok(_) => {}
            Err(RecordError::Write(_)) if !self.waits => self.has_ended = true,
            Err(error) => panic!("{error}"),
        }
    }

    /// Ends the recording, and checks the account.
    fn end(mut self) {
        let is_killed = !self.has_ended && self.random.one_in(4);
        // As after kill -9: nothing more is written.
        let is_full = self.disk.is_full();
        if is_killed {
            self.disk.kill();
        }
        self.disk.stall(false);
        if !is_killed && self.waits {
            self.disk.repair();
        }
        if !is_killed && !self.has_ended {
            self.drain();
        }
        let finished = self.recorder.finish();
        self.talkers.end();
        if let Err(error) = &finished {
            assert!(is_killed || is_full || self.has_ended, "{error}");
        }
        let path = self.folder.join("bag");
        check::check(&path, finished.as_ref().ok(), &self.talkers, !is_full);
        if finished.is_ok() && self.random.one_in(2) {
            check::damage(&path, &self.talkers, &mut self.random);
        }
    }

    /// Lets the recorder take and write what has come.
    fn drain(&mut self) {
        until("everything is written", || {
            self.step();
            self.has_ended || self.recorder.progress().waiting_bytes == 0
        });
    }
}
