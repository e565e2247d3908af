//! A recording that is divided into files, and the room that it leaves.

use std::fs::{self, File};
use std::io;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use sm2_bag::{
    Bag, Filter, Folder, Options, PlayOptions, Player, Recorder, Report, Split, Step, Storage,
    check,
};
use sm2_node::{Name, Node, Publisher, Shutdown};

use crate::common::{Domain, SOON, named, until};

const MESSAGE_LEN: usize = 10_000;

/// Records this number of messages into a folder. Each one begins with its number.
fn record_in(domain: &Domain, folder: Folder, split: Split, count: u64) -> Report {
    let talker = domain.node("talker");
    let data = talker.publisher_builder::<[u8]>("data");
    let data = data.reliable(true).publish_timeout(SOON).declare().unwrap();
    let node = domain.node("recorder");
    let shutdown = Shutdown::new().unwrap();
    let options = Options {
        reliable: [Name::new("data").unwrap()].into(),
        ..Options::new(named(&["data"]))
    };
    let mut recorder = Recorder::start_in(&node, folder, split, options, shutdown.as_fd()).unwrap();
    wait_for_link(&data, &mut recorder);
    for number in 0..count {
        let mut message = vec![0; MESSAGE_LEN];
        message[..8].copy_from_slice(&number.to_le_bytes());
        until("there is room for a message", || {
            recorder.step(Duration::from_millis(1)).unwrap();
            data.try_publish(&message).unwrap().is_some()
        });
    }
    until("all messages are written", || {
        recorder.step(Duration::from_millis(1)).unwrap();
        recorder.progress().messages == count
    });
    recorder.finish().unwrap()
}

fn wait_for_link(data: &Publisher<[u8]>, recorder: &mut Recorder<'_>) {
    until("the recorder is linked", || {
        recorder.step(Duration::from_millis(1)).unwrap();
        data.links().iter().any(|it| it.open)
    });
}

/// The bags of a folder in the order of their names.
fn bags(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    let mut paths: Vec<_> = entries.map(|it| it.unwrap().path()).collect();
    paths.sort();
    paths
}

/// The numbers of the messages of bags, which are all complete.
fn numbers(paths: &[PathBuf]) -> Vec<u64> {
    let mut numbers = Vec::new();
    for path in paths {
        assert_eq!(check(path).unwrap().damages, []);
        let bag = Bag::open(path).unwrap();
        for message in bag.messages(&Filter::default()) {
            let data = message.unwrap().data;
            numbers.push(u64::from_le_bytes(data[..8].try_into().unwrap()));
        }
    }
    numbers
}

#[test]
fn a_file_ends_before_it_is_too_long() {
    let domain = Domain::new();
    let path = domain.path("drive");
    let folder = Folder::new(&path, "bag").unwrap();
    let split = Split {
        bytes: Some(100_000),
        time: None,
    };
    let report = record_in(&domain, folder.clone(), split, 95);
    let bags = bags(&path);
    assert!((10..=12).contains(&bags.len()), "{bags:?}");
    assert_eq!(folder.counts(), (bags.len() as u32, 0));
    assert!(bags[0].ends_with("bag-0001.mcap"));
    for bag in &bags {
        // The summary comes on top.
        assert!(fs::metadata(bag).unwrap().len() < 110_000);
    }
    assert_eq!(numbers(&bags), Vec::from_iter(0..95));
    let topic = &report.topics[0];
    assert_eq!((topic.messages, topic.lost), (95, 0));
    assert_eq!(topic.bytes, Some(95 * MESSAGE_LEN as u64));
    assert!(report.complete && report.start_ns < report.end_ns);
}

#[test]
fn the_files_of_a_folder_are_played_as_one() {
    let domain = Domain::new();
    let path = domain.path("drive");
    let split = Split {
        bytes: Some(100_000),
        time: None,
    };
    record_in(&domain, Folder::new(&path, "bag").unwrap(), split, 50);
    // The order of the bags does not matter.
    let paths = bags(&path);
    let bags: Vec<_> = paths
        .iter()
        .rev()
        .map(|it| Bag::open(it).unwrap())
        .collect();
    assert!(bags.len() > 3);
    let listener = domain.node("listener").subscriber_builder::<[u8]>("data");
    let listener = listener.reliable(true).depth(64).declare().unwrap();
    let shutdown = Shutdown::new().unwrap();
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    let options = PlayOptions {
        rate: 0.0,
        ..PlayOptions::default()
    };
    let mut player = Player::new(&bags, options, connect, shutdown.as_fd()).unwrap();
    thread::scope(|scope| {
        scope.spawn(|| {
            for number in 0..50_u64 {
                let message = listener.recv_timeout(SOON).unwrap().unwrap();
                assert_eq!(message[..8], number.to_le_bytes());
            }
        });
        let played = player.play().unwrap();
        assert_eq!((played.topics.len(), played.topics[0].messages), (1, 50));
        assert!(played.complete);
    });
    // One publisher, although each bag has a channel of its own.
    assert_eq!(listener.links().len(), 1);
}

#[test]
fn a_file_ends_after_its_time() {
    let domain = Domain::new();
    let path = domain.path("drive");
    let split = Split {
        bytes: None,
        time: Some(Duration::from_nanos(1)),
    };
    record_in(&domain, Folder::new(&path, "bag").unwrap(), split, 5);
    // Two messages of one burst may have the same time.
    let bags = bags(&path);
    assert!((2..=5).contains(&bags.len()), "{bags:?}");
    assert_eq!(numbers(&bags), Vec::from_iter(0..5));
}

#[test]
fn a_ring_removes_the_oldest_bags_also_of_earlier_recordings() {
    let domain = Domain::new();
    let path = domain.path("ring");
    let split = Split {
        bytes: Some(50_000),
        time: None,
    };
    let limit = 300_000;
    let ring = |stem| {
        let folder = Folder::new(&path, stem).unwrap();
        folder.keep_bytes(limit, "bag-").unwrap()
    };
    fs::create_dir(&path).unwrap();
    fs::write(path.join("photo.mcap"), [0; 200_000]).unwrap();
    let folder = ring("bag-a");
    record_in(&domain, folder.clone(), split, 100);
    let (created, removed) = folder.counts();
    assert!(created > 15 && removed > 10, "{created}, {removed}");
    let first = bags(&path);
    // And the photo.
    assert_eq!((created - removed) as usize, first.len() - 1);
    let kept = numbers(&first[..first.len() - 1]);
    assert_eq!(kept, Vec::from_iter(100 - kept.len() as u64..100));
    record_in(&domain, ring("bag-b"), split, 10);
    let second = bags(&path);
    let len: u64 = second
        .iter()
        .map(|it| fs::metadata(it).unwrap().len())
        .sum();
    assert!(len <= limit + 200_000, "{len} bytes");
    let is_old = |it: &&PathBuf| it.to_string_lossy().contains("bag-a");
    let old = second.iter().filter(is_old).count();
    assert!(0 < old && old < first.len() - 1, "{second:?}");
    // A file with another name is not the recorder's.
    assert!(path.join("photo.mcap").exists());
}

/// A clock without a battery gives two recordings the same stem.
#[test]
fn a_second_recording_with_the_same_stem_goes_on_counting() {
    let domain = Domain::new();
    let path = domain.path("drive");
    let split = Split {
        bytes: Some(50_000),
        time: None,
    };
    let folder = || Folder::new(&path, "bag").unwrap();
    record_in(&domain, folder(), split, 20);
    let first = bags(&path);
    record_in(&domain, folder(), split, 20);
    let both = bags(&path);
    assert_eq!(both[..first.len()], first);
    assert_eq!(numbers(&first), Vec::from_iter(0..20));
    assert_eq!(numbers(&both[first.len()..]), Vec::from_iter(0..20));
}

/// A file on a disk that is soon full.
struct Small {
    file: File,
    len: u64,
}

impl Storage for Small {
    fn write_at(&mut self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.len = self.len.max(offset + bytes.len() as u64);
        Storage::write_at(&mut self.file, bytes, offset)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync()
    }

    fn free_bytes(&self) -> io::Result<Option<u64>> {
        // A thread that runs late writes more than this disk has.
        Ok(Some(1_000_000_u64.saturating_sub(self.len)))
    }
}

#[test]
fn a_recording_ends_in_order_before_the_disk_is_full() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let data = talker.publisher::<[u8]>("data").unwrap();
    let node = domain.node("recorder");
    let shutdown = Shutdown::new().unwrap();
    let options = Options {
        sync_interval: Duration::from_millis(1),
        min_free_bytes: 500_000,
        ..Options::new(named(&["data"]))
    };
    let disk = Small {
        file: domain.create("bag"),
        len: 0,
    };
    let mut recorder = Recorder::start(&node, disk, options, shutdown.as_fd()).unwrap();
    wait_for_link(&data, &mut recorder);
    let mut sent = 0;
    until("the disk is full", || {
        data.publish(&[1; MESSAGE_LEN]).unwrap();
        sent += 1;
        recorder.step(Duration::from_millis(5)).unwrap() == Step::DiskFull
    });
    assert!(sent > 40, "{sent}");
    let report = recorder.finish().unwrap();
    let topic = &report.topics[0];
    assert_eq!(topic.messages + topic.lost, sent);
    assert_eq!(Bag::open(&domain.path("bag")).unwrap().report(), report);
    assert_eq!(check(&domain.path("bag")).unwrap().damages, []);
}
