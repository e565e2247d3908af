//! A publisher with a bug writes to slots that it has sent. It spoils the content of its own messages, and nothing
//! else.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use sm2_bag::{
    Bag, BagFile, BagMessage, Compression, Filter, Options, Report, Storage, SyncWork, check, copy,
    recover,
};
use sm2_node::{Name, Publisher};

use crate::common::{Domain, SOON, named, record};

/// The lengths of the messages, in bytes: two are in common chunks, one is a chunk of its own.
const LENS: [usize; 3] = [100, 60 << 10, 1_000_000];
const LEN_MAX: usize = 1_000_000;
const ROUNDS: usize = 20;
/// How many bytes of a slot are written at a time.
const PLACES: usize = 16;

/// Between two times that all slots are changed: the publisher has its turn.
const PAUSE: Duration = Duration::from_millis(1);

/// The slots that a publisher has sent. The memory is that of this process.
struct Sent {
    memory: File,
    /// The segments, which this process maps as long as their publishers live.
    segments: Vec<Range<usize>>,
    /// The addresses and lengths of the messages.
    messages: Mutex<BTreeMap<usize, usize>>,
}

impl Sent {
    fn new() -> Self {
        let maps = fs::read_to_string("/proc/self/maps").unwrap();
        let segments = maps.lines().filter_map(|line| {
            let (range, rest) = line.split_once(' ')?;
            let (start, end) = range.split_once('-')?;
            let address = |hex| usize::from_str_radix(hex, 16).ok();
            let is_written = rest.starts_with("rw-s") && rest.contains("memfd:sm2-segment");
            Some(address(start)?..address(end)?).filter(|_| is_written)
        });
        Self {
            segments: segments.collect(),
            memory: OpenOptions::new()
                .read(true)
                .write(true)
                .open("/proc/self/mem")
                .unwrap(),
            messages: Mutex::default(),
        }
    }

    /// Publishes a message, and keeps its place. A message that is in no slot is not published.
    fn publish(&self, publisher: &Publisher<[u8]>, len: usize) {
        let mut messages = self.messages.lock().unwrap();
        let mut loan = publisher.loan_slice(len).unwrap();
        let address = loan.as_ptr().addr();
        if self.segments.iter().any(|it| it.contains(&address)) {
            loan.fill(1);
            messages.insert(address, len);
            loan.publish().unwrap();
        }
    }

    /// Changes all messages.
    fn rewrite(&self) {
        let messages = self.messages.lock().unwrap();
        for (address, len) in messages.iter() {
            for place in 0..PLACES {
                let at = address + (len - 1) * place / PLACES;
                let mut byte = [0];
                self.memory.read_at(&mut byte, at as u64).unwrap();
                byte[0] = byte[0].wrapping_add(1);
                self.memory.write_at(&byte, at as u64).unwrap();
            }
        }
    }
}

/// A file whose writes wait until all slots have been changed.
struct Rewriting<S> {
    file: S,
    sent: Arc<Sent>,
}

impl<S: Storage> Storage for Rewriting<S> {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.sent.rewrite();
        self.file.write_at(bytes, offset)
    }

    fn write_blocks_at(&mut self, blocks: &[u8], offset: u64) -> io::Result<()> {
        self.sent.rewrite();
        self.file.write_blocks_at(blocks, offset)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync()
    }

    fn begin_sync(&mut self) -> io::Result<Option<SyncWork>> {
        self.file.begin_sync()
    }
}

/// A message of the other publisher, which only its number determines.
fn payload(number: usize) -> Vec<u8> {
    let bytes = (0..LENS[number % LENS.len()]).map(|at| (at / 3 + number * 50) as u8);
    bytes.collect()
}

/// Records both publishers, while the slots of one of them are changed all the time.
fn record_both(domain: &Domain, file: impl Storage + 'static, compression: Compression) -> Report {
    let publisher = |name: &str| {
        let publisher = domain.node(name).publisher_builder::<[u8]>(name);
        let publisher = publisher.reliable(true).publish_timeout(SOON);
        let publisher = publisher.wait_share_percent(100).inline_max(0);
        publisher.max_len(LEN_MAX).slots(90).declare().unwrap()
    };
    let (honest, careless) = (publisher("honest"), publisher("careless"));
    let sent = Arc::new(Sent::new());
    let storage = Rewriting {
        file,
        sent: Arc::clone(&sent),
    };
    let topics = ["honest", "careless"];
    let options = Options {
        compression,
        reliable: topics.map(|it| Name::new(it).unwrap()).into(),
        ..Options::new(named(&topics))
    };
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                sent.rewrite();
                thread::sleep(PAUSE);
            }
        });
        let report = record(&domain.node("recorder"), storage, options, |record_until| {
            for publisher in [&honest, &careless] {
                record_until(&mut |_| publisher.links().iter().any(|it| it.open));
            }
            for number in 0..ROUNDS * LENS.len() {
                sent.publish(&careless, LENS[number % LENS.len()]);
                record_until(&mut |_| honest.try_publish(&payload(number)).unwrap().is_some());
                // Both publishers have room for the next message.
                record_until(&mut |it| it.progress().messages + 30 > 2 * number as u64);
            }
        });
        is_over.store(true, Ordering::Relaxed);
        report
    })
}

fn messages(path: &Path, topic: &str) -> Vec<BagMessage> {
    let bag = Bag::open(path).unwrap();
    let filter = Filter {
        topics: [topic.to_owned()].into(),
        ..Filter::default()
    };
    let messages = bag.messages(&filter);
    messages.map(|it| it.unwrap()).collect()
}

/// The bag is whole, and has all messages of the other publisher as they were published.
fn assert_honest(path: &Path) {
    assert_eq!(check(path).unwrap().damages, []);
    let honest = messages(path, "honest");
    assert_eq!(honest.len(), ROUNDS * LENS.len());
    for (number, message) in honest.iter().enumerate() {
        assert!(message.data == payload(number), "{number}");
    }
    let careless = messages(path, "careless").into_iter();
    let lens: Vec<_> = careless.map(|it| it.data.len()).collect();
    assert!(lens.contains(&LEN_MAX), "{lens:?}");
}

/// The bag that was recorded to this file is whole, and so are its copies.
fn assert_confined(domain: &Domain, name: &str, file: impl Storage + 'static, of: Compression) {
    let report = record_both(domain, file, of);
    let lost: u64 = report.topics.iter().map(|it| it.lost).sum();
    assert_eq!((report.complete, lost), (true, 0));
    let path = domain.path(name);
    assert_honest(&path);
    let copied = domain.path("copied");
    copy(
        &[Bag::open(&path).unwrap()],
        &copied,
        &Filter::default(),
        of,
    )
    .unwrap();
    assert_honest(&copied);
    let recovered = domain.path("recovered");
    recover(&path, &recovered).unwrap();
    assert_honest(&recovered);
}

fn assert_confined_in_a_file(compression: Compression) {
    let domain = Domain::new();
    let file = domain.create("bag");
    assert_confined(&domain, "bag", file, compression);
}

#[test]
fn a_rewritten_slot_spoils_only_its_own_message() {
    assert_confined_in_a_file(Compression::None);
}

#[test]
fn a_rewritten_slot_spoils_only_its_own_message_with_lz4() {
    assert_confined_in_a_file(Compression::Lz4);
}

#[test]
fn a_rewritten_slot_spoils_only_its_own_message_with_zstd() {
    assert_confined_in_a_file(Compression::Zstd);
}

#[test]
fn a_rewritten_slot_spoils_only_its_own_message_without_the_page_cache() {
    let domain = Domain::new();
    let file = BagFile::create(&domain.path("bag")).unwrap();
    assert_confined(&domain, "bag", file, Compression::None);
}
