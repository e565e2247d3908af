//! A power cut costs the last interval, whatever part of it has reached the disk.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use sm2_bag::{Bag, Compression, Filter, Options, Storage, SyncWork, recover};
use sm2_test_support::seed;

use crate::common::{Domain, SOON, memory_folder, named, record};

const MESSAGES: u64 = 100;
/// How many power cuts at random moments are tried for each compression.
const CUTS: usize = if cfg!(feature = "slow") { 500 } else { 12 };
/// More cuts than this leave some messages, and not all.
const PARTIAL_MIN: u64 = if cfg!(feature = "slow") { 50 } else { 0 };
/// After so many messages, the next one waits until the recorder has synchronized again.
const MESSAGES_PER_SYNC: u64 = 25;
/// Long enough for several messages.
const INTERVAL: Duration = Duration::from_millis(10);
/// A disk writes sectors.
const SECTOR_LEN: u64 = 512;

/// An operation of a recorder on its file.
#[derive(Clone, Debug)]
enum Operation {
    Write(u64, Vec<u8>),
    /// Everything before the operation `safe` is on the disk.
    Sync {
        safe: usize,
        /// The number of messages that had been written at the synchronization before: the recorder began this one
        /// later.
        written: u64,
    },
}

/// A file that remembers its operations, and has no other content.
struct Logged {
    operations: Arc<Mutex<Vec<Operation>>>,
    /// How many messages the recorder has written, or fewer; and how many it had at the last synchronization.
    written: (Arc<AtomicU64>, u64),
    /// Whether writing goes on during a synchronization.
    is_concurrent: bool,
}

impl Logged {
    fn note(&self, operation: Operation) {
        self.operations.lock().unwrap().push(operation);
    }

    /// The synchronization that begins now.
    fn synchronization(&mut self) -> Operation {
        let now = self.written.0.load(Ordering::SeqCst);
        Operation::Sync {
            safe: self.operations.lock().unwrap().len(),
            written: std::mem::replace(&mut self.written.1, now),
        }
    }
}

impl Storage for Logged {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.note(Operation::Write(offset, bytes.to_vec()));
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        let operation = self.synchronization();
        self.note(operation);
        Ok(())
    }

    fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
        if !self.is_concurrent {
            return Ok(None);
        }
        let (operation, operations) = (self.synchronization(), Arc::clone(&self.operations));
        Ok(Some(Box::new(move || {
            // Longer than an interval, so the next one is written meanwhile.
            thread::sleep(2 * INTERVAL);
            operations.lock().unwrap().push(operation);
            Ok(())
        })))
    }
}

/// The length of a message. Some are long, so that they are chunks of their own.
fn len_bytes(number: u64) -> usize {
    match number % 25 {
        0 => 70_000 + number as usize * 100,
        _ => 8,
    }
}

/// A message that only its number determines.
fn payload(number: u64) -> Vec<u8> {
    let words = (0..).flat_map(|at: u64| (number + at).to_le_bytes());
    words.take(len_bytes(number)).collect()
}

/// Records these messages. Returns the operations, and how many of them there were after some synchronizations, when
/// the last messages had not come.
fn operations(
    payloads: &[Vec<u8>],
    compression: Compression,
    is_concurrent: bool,
) -> (Vec<Operation>, usize) {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let numbers = talker.publisher::<[u8]>("numbers").unwrap();
    let node = domain.node("recorder");
    let (operations, written) = (Arc::default(), Arc::<AtomicU64>::default());
    let storage = Logged {
        operations: Arc::clone(&operations),
        written: (Arc::clone(&written), 0),
        is_concurrent,
    };
    let options = Options {
        compression,
        sync_interval: INTERVAL,
        ..Options::new(named(&["numbers"]))
    };
    let mut early = 0;
    record(&node, storage, options, |record_until| {
        record_until(&mut |_| numbers.links().iter().any(|it| it.open));
        let mut number = 0;
        for payload in payloads {
            let before = synchronizations(&operations.lock().unwrap());
            numbers.publish(payload).unwrap();
            let mut is_taken = false;
            record_until(&mut |it| {
                // The writer has written the messages before this one.
                written.store(it.progress().messages, Ordering::SeqCst);
                std::mem::replace(&mut is_taken, true)
            });
            thread::sleep(Duration::from_millis(1));
            number += 1;
            if number % MESSAGES_PER_SYNC == 0 {
                record_until(&mut |it| {
                    let syncs = synchronizations(&operations.lock().unwrap());
                    it.progress().messages == number && syncs > before
                });
                if number < MESSAGES {
                    early = operations.lock().unwrap().len();
                }
            }
        }
        record_until(&mut |it| it.progress().messages == MESSAGES);
    });
    let done = operations.lock().unwrap();
    (done.clone(), early)
}

fn synchronizations(operations: &[Operation]) -> usize {
    let is_sync = |it: &&Operation| matches!(it, Operation::Sync { .. });
    operations.iter().filter(is_sync).count()
}

/// As [`operations`]. If writing goes on during synchronizations, at least one write has overtaken one.
fn overtaken_operations(
    payloads: &[Vec<u8>],
    compression: Compression,
    is_concurrent: bool,
) -> (Vec<Operation>, usize) {
    let end = Instant::now() + SOON;
    loop {
        let (operations, early) = operations(payloads, compression, is_concurrent);
        let is_overtaken = |(at, it): (usize, &Operation)| match it {
            Operation::Sync { safe, .. } => *safe < at,
            Operation::Write(..) => false,
        };
        let has_overtaken = operations.iter().enumerate().any(is_overtaken);
        assert!(is_concurrent || !has_overtaken);
        if has_overtaken == is_concurrent {
            return (operations, early);
        }
        // On a busy machine no message may come while the recorder synchronizes.
        assert!(Instant::now() < end, "no write during a synchronization");
    }
}

/// The numbers of the messages in a bag, which are those of `payloads` but for damaged parts. A file without its first
/// bytes is not a bag.
fn readable(path: &Path, payloads: &[Vec<u8>]) -> Vec<usize> {
    let Ok(bag) = Bag::open(path) else {
        return Vec::new();
    };
    let mut numbers = Vec::new();
    for message in bag.messages(&Filter::default()) {
        let (data, after) = (message.unwrap().data, numbers.last().map_or(0, |it| it + 1));
        let number = payloads.iter().skip(after).position(|it| *it == data);
        numbers.push(after + number.expect("it was recorded after the message before"));
    }
    let has_gap = !numbers.iter().copied().eq(0..numbers.len());
    assert!(!has_gap || !bag.report().damaged.is_empty(), "{numbers:?}");
    numbers
}

#[test]
fn a_power_cut_costs_no_more_than_the_last_interval() {
    let payloads: Vec<_> = (0..MESSAGES).map(payload).collect();
    let folder = memory_folder();
    let (path, whole) = (folder.path().join("cut"), folder.path().join("whole"));
    for (compression, is_concurrent) in [
        (Compression::None, false),
        (Compression::None, true),
        (Compression::Lz4, true),
        (Compression::Zstd, false),
    ] {
        let (operations, early) = overtaken_operations(&payloads, compression, is_concurrent);
        let mut state = seed();
        let mut random = |below: usize| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as usize % below
        };
        let mut partial = 0;
        for number in 0..=CUTS {
            let end = match number {
                // A moment when some messages are safe, and others have not come.
                0 => early,
                _ => random(operations.len() + 1),
            };
            let (safe, promised) = last_sync(&operations[..end]);
            let file = File::create(&path).unwrap();
            for operation in &operations[..safe] {
                if let Operation::Write(at, bytes) = operation {
                    file.write_all_at(bytes, *at).unwrap();
                }
            }
            let synchronized = readable(&path, &payloads);
            let is_promised = |it: &&usize| (**it as u64) < promised;
            let kept = synchronized.iter().filter(is_promised).count() as u64;
            assert_eq!(kept, promised);
            // Any sectors of the later writes have reached the disk, and any length of the file.
            for operation in &operations[safe..end] {
                let Operation::Write(at, bytes) = operation else {
                    continue;
                };
                for sector in sectors(*at, bytes) {
                    if random(2) == 0 {
                        file.write_all_at(sector.1, sector.0).unwrap();
                    }
                }
                if random(2) == 0 {
                    let len = file.metadata().unwrap().len().max(at + bytes.len() as u64);
                    file.set_len(len).unwrap();
                }
            }
            let left = readable(&path, &payloads);
            assert!(
                synchronized.iter().all(|it| left.contains(it)),
                "{left:?} of {synchronized:?}"
            );
            partial += u64::from(!left.is_empty() && (left.len() as u64) < MESSAGES);
            if !left.is_empty() {
                recover(&path, &whole).unwrap();
                assert_eq!(readable(&whole, &payloads), left);
                fs::remove_file(&whole).unwrap();
            }
        }
        assert!(partial > PARTIAL_MIN, "{compression:?}: {partial}");
    }
}

/// The number of operations before the last synchronization, and the number of messages that were written by then.
fn last_sync(operations: &[Operation]) -> (usize, u64) {
    let mut before = operations.iter().rev();
    let last = before.find_map(|it| match it {
        Operation::Sync { safe, written } => Some((*safe, *written)),
        Operation::Write(..) => None,
    });
    last.unwrap_or((0, 0))
}

/// The parts of a write that stand in different sectors of the disk.
fn sectors(at: u64, bytes: &[u8]) -> Vec<(u64, &[u8])> {
    let mut parts = Vec::new();
    let (mut at, mut rest) = (at, bytes);
    while !rest.is_empty() {
        let len = ((SECTOR_LEN - at % SECTOR_LEN) as usize).min(rest.len());
        let (part, more) = rest.split_at(len);
        parts.push((at, part));
        at += len as u64;
        rest = more;
    }
    parts
}
