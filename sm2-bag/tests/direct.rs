//! Long payloads go to the disk in whole blocks.

use std::fs::{self, File};
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex};

use sm2_bag::{Bag, BagFile, Filter, Options, Report, Storage, check};
use sm2_node::Name;
use tempfile::TempDir;

use crate::common::{Domain, SOON, named, record};

const BLOCK_LEN: usize = 4_096;
/// The lengths of the messages, in bytes: short ones, long ones with and without a last part of a block, and one that
/// takes more than one buffer.
const LENS: [usize; 8] = [10, 65_537, 100, 73_728, 9_000_000, 1, 1_000_000, 81_919];

/// A payload that only its number determines.
fn payload(number: usize) -> Vec<u8> {
    let bytes = (0..LENS[number]).map(|at| (at / 7 + number * 50) as u8);
    bytes.collect()
}

/// Records a message of each length.
fn record_all(domain: &Domain, storage: impl Storage + 'static) -> Report {
    let talker = domain.node("talker");
    let camera = talker.publisher_builder::<[u8]>("camera");
    let camera = camera.reliable(true).publish_timeout(SOON);
    let camera = camera.declare().unwrap();
    let recorder = domain.node("recorder");
    let options = Options {
        reliable: [Name::new("camera").unwrap()].into(),
        ..Options::new(named(&["camera"]))
    };
    record(&recorder, storage, options, |record_until| {
        record_until(&mut |_| camera.links().iter().any(|it| it.open));
        for number in 0..LENS.len() {
            record_until(&mut |_| camera.try_publish(&payload(number)).unwrap().is_some());
        }
        record_until(&mut |it| it.progress().messages == LENS.len() as u64);
    })
}

/// The bag has all messages, and nothing is wrong with it.
fn assert_whole(path: &Path, report: &Report) {
    let bag = Bag::open(path).unwrap();
    assert!(report.complete);
    assert_eq!(bag.report(), *report);
    let messages = bag.messages(&Filter::default());
    let mut count = 0;
    for (number, message) in messages.enumerate() {
        assert!(message.unwrap().data == payload(number), "{number}");
        count += 1;
    }
    assert_eq!(count, LENS.len());
    assert_eq!(check(path).unwrap().damages, []);
}

/// A file that counts the blocks.
struct Counted {
    file: File,
    blocks: Arc<Mutex<usize>>,
}

impl Storage for Counted {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        assert!(
            bytes.len() < 2 * 65_536,
            "{} bytes outside of blocks in one write",
            bytes.len()
        );
        Storage::write_at(&mut self.file, bytes, offset)
    }

    fn write_blocks_at(&mut self, blocks: &[u8], offset: u64) -> io::Result<()> {
        assert_eq!(offset as usize % BLOCK_LEN, 0);
        assert_eq!(blocks.as_ptr().addr() % BLOCK_LEN, 0);
        assert_eq!(blocks.len() % BLOCK_LEN, 0);
        *self.blocks.lock().unwrap() += blocks.len() / BLOCK_LEN;
        Storage::write_at(&mut self.file, blocks, offset)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync()
    }
}

/// A folder on a disk: files in memory are always in the page cache.
fn disk_folder() -> TempDir {
    tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap()
}

#[test]
fn whole_blocks_of_long_payloads_are_written_as_blocks() {
    let domain = Domain::new();
    let blocks = Arc::<Mutex<usize>>::default();
    let storage = Counted {
        file: domain.create("bag"),
        blocks: Arc::clone(&blocks),
    };
    let report = record_all(&domain, storage);
    let long = LENS.into_iter().filter(|it| *it > 65_536);
    let expected: usize = long.map(|it| it / BLOCK_LEN).sum();
    assert_eq!(*blocks.lock().unwrap(), expected);
    assert_whole(&domain.path("bag"), &report);
}

#[test]
fn a_bag_file_is_whole_with_and_without_the_page_cache() {
    let domain = Domain::new();
    let folder = disk_folder();
    let path = folder.path().join("direct");
    let report = record_all(&domain, BagFile::create(&path).unwrap());
    assert_whole(&path, &report);
    let error = BagFile::create(&path).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);

    // A bag that is recorded without BagFile differs in nothing but its times.
    let report = record_all(&domain, domain.create("buffered"));
    assert_whole(&domain.path("buffered"), &report);
    let len = |path| fs::metadata(path).unwrap().len();
    assert_eq!(len(path), len(domain.path("buffered")));
}

#[test]
fn foreign_bytes_behind_a_payload_are_not_recorded() {
    let domain = Domain::new();
    let folder = disk_folder();
    let path = folder.path().join("bag");
    record_all(&domain, BagFile::create(&path).unwrap());
    let file = fs::read(&path).unwrap();
    // The payload of 1,000,000 bytes was in the slot and in the buffer before; the one of 81,919 bytes ends in a block.
    let last = payload(7);
    let mut blocks = (0..file.len()).step_by(BLOCK_LEN);
    let from = blocks.find(|it| file[*it..].starts_with(&last)).unwrap();
    let behind = &file[from + last.len()..][..9];
    // The index of the messages of the chunk: opcode 7, and its length.
    assert_eq!(behind, [7, 22, 0, 0, 0, 0, 0, 0, 0]);
}
