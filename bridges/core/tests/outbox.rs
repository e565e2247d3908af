//! The outbox: its files, restarts, damage, and a full disk.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use nix::sys::resource::{Resource, setrlimit};
use signal_hook::consts::SIGXFSZ;
use sm2_bridge_core::{Durable, Limits, Origin, Outbox, StoreError};
use sm2_proto::{Instant, Name, TypeId};
use sm2_test_support::ran_alone;
use tempfile::TempDir;

const NOW: Instant = Instant(1_000_000_000);
const WALL: u64 = 1_800_000_000_000_000_000;

fn limits() -> Limits {
    Limits::new(1 << 30, 1 << 20).unwrap()
}

fn open(folder: &Path) -> Outbox {
    Outbox::open(folder, limits(), NOW, WALL).unwrap()
}

/// Message `number` of `topic`; its length and content follow from the number.
fn message(topic: &str, number: u64, len: usize) -> Durable {
    Durable {
        topic: Name::new(topic).unwrap(),
        data: TypeId {
            name: Name::new("pose").unwrap(),
            hash: 7,
        },
        origin: Origin {
            bridge: Name::new("robot").unwrap(),
            epoch: 5,
            number,
        },
        time: WALL - 1,
        payload: Bytes::from(vec![number as u8; len]),
    }
}

/// An outbox with messages of 1 MiB, which are in several files.
fn with_images(folder: &Path, count: u64) -> Outbox {
    let mut outbox = open(folder);
    for number in 0..count {
        let message = message("image", number, 1 << 20);
        outbox.offer(message, NOW).unwrap();
    }
    outbox
}

/// Sends and acknowledges all that can be sent.
fn hand_over(outbox: &mut Outbox) -> Vec<Durable> {
    let mut messages = Vec::new();
    while let Some(message) = outbox.poll(NOW).unwrap() {
        outbox.acknowledge(&message.topic, &message.origin);
        messages.push(message);
    }
    messages
}

fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let names = entries.map(|it| it.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<_> = names.filter(|it| it != "lock").collect();
    names.sort();
    names
}

#[test]
fn messages_come_back_after_a_restart_with_their_origins() {
    let folder = TempDir::new().unwrap();
    let mut outbox = open(folder.path());
    // A number above 32 bits, and two topics.
    let all = [
        message("pose", 1, 10),
        message("map", 1 << 40, 0),
        message("pose", 2, 5_000),
    ];
    for message in &all {
        outbox.offer(message.clone(), NOW).unwrap();
    }
    drop(outbox);
    let mut outbox = open(folder.path());
    assert_eq!(outbox.counts().spooled, 3);
    let after = message("pose", 3, 1);
    outbox.offer(after.clone(), NOW).unwrap();
    outbox.connect();
    assert_eq!(hand_over(&mut outbox), [all.as_slice(), &[after]].concat());
    assert!(outbox.counts().is_balanced());
    drop(outbox);
    // The file that was written last is empty of messages without a fate, but its program did not know that.
    assert_eq!(files(folder.path()).len(), 1);
}

#[test]
fn files_are_removed_when_all_their_messages_have_their_fate() {
    let folder = TempDir::new().unwrap();
    let mut outbox = with_images(folder.path(), 40);
    let many = files(folder.path()).len();
    assert!((5..=7).contains(&many), "{many} files for 40 MiB");
    outbox.connect();
    for number in 0..40 {
        let sent = outbox.poll(NOW).unwrap().unwrap();
        assert_eq!(sent, message("image", number, 1 << 20));
        outbox.acknowledge(&sent.topic, &sent.origin);
    }
    assert!(outbox.poll(NOW).unwrap().is_none());
    assert_eq!(files(folder.path()).len(), 1, "the newest one");
}

#[test]
fn a_message_that_was_not_acknowledged_is_read_again_from_its_file() {
    let folder = TempDir::new().unwrap();
    let mut outbox = with_images(folder.path(), 20);
    outbox.connect();
    for _ in 0..3 {
        let sent = outbox.poll(NOW).unwrap().unwrap();
        assert_eq!(sent.origin.number, 0);
        outbox.disconnect(NOW);
        outbox.connect();
    }
    assert_eq!(hand_over(&mut outbox).len(), 20);
}

#[test]
fn what_is_before_a_damage_is_kept() {
    let folder = TempDir::new().unwrap();
    let mut outbox = open(folder.path());
    for number in 0..3 {
        outbox.offer(message("pose", number, 100), NOW).unwrap();
    }
    let file = folder.path().join(&files(folder.path())[0]);
    let torn = fs::read(&file).unwrap();
    drop(outbox);
    fs::write(&file, &torn[..torn.len() - 1]).unwrap();
    fs::write(folder.path().join("0000000000000007.mcap"), b"no bag").unwrap();
    fs::write(folder.path().join("notes.txt"), b"not of the outbox").unwrap();
    let mut outbox = open(folder.path());
    assert_eq!(files(folder.path()).len(), 2, "nothing was in one of them");
    outbox.connect();
    let numbers = hand_over(&mut outbox)
        .into_iter()
        .map(|it| it.origin.number);
    assert_eq!(numbers.collect::<Vec<_>>(), [0, 1]);
    outbox.offer(message("pose", 9, 1), NOW).unwrap();
    assert!(files(folder.path()).contains(&"0000000000000008.mcap".to_owned()));
}

#[test]
fn a_message_that_is_too_long_leaves_nothing() {
    let folder = TempDir::new().unwrap();
    let mut outbox = open(folder.path());
    outbox
        .offer(message("image", 1, (1 << 20) + 1), NOW)
        .unwrap();
    outbox.offer(message("image", 2, 1), NOW).unwrap();
    assert!(outbox.poll(NOW).unwrap().is_none());
    assert_eq!((outbox.counts().refused, outbox.counts().spooled), (1, 1));
}

#[test]
fn a_folder_belongs_to_one_outbox() {
    let folder = TempDir::new().unwrap();
    let outbox = open(folder.path());
    let second = Outbox::open(folder.path(), limits(), NOW, WALL);
    assert!(
        matches!(second, Err(StoreError::Locked { .. })),
        "{second:?}"
    );
    drop(outbox);
    drop(open(folder.path()));
}

#[test]
fn a_file_that_has_lost_messages_is_reported_and_they_count_as_refused() {
    let folder = TempDir::new().unwrap();
    let mut outbox = with_images(folder.path(), 20);
    let file = folder.path().join(&files(folder.path())[0]);
    fs::write(&file, b"").unwrap();
    outbox.connect();
    let error = outbox.poll(NOW).unwrap_err();
    assert!(
        matches!(&error, StoreError::Damaged { path } if *path == file),
        "{error}"
    );
    let mut sent = 0;
    while outbox.counts().spooled > 0 || outbox.counts().in_flight > 0 {
        if let Ok(Some(message)) = outbox.poll(NOW) {
            outbox.acknowledge(&message.topic, &message.origin);
            sent += 1;
        }
    }
    let counts = outbox.counts();
    assert_eq!((counts.handed_over, counts.refused), (sent, 20 - sent));
    assert!(
        counts.is_balanced() && sent > 0 && counts.refused > 0,
        "{counts:?}"
    );
}

/// The kernel limits the length of files as a full disk would.
#[test]
fn a_full_disk_refuses_messages_and_keeps_the_others() {
    const LIMIT: u64 = 64 << 10;
    if ran_alone(concat!(
        module_path!(),
        "::a_full_disk_refuses_messages_and_keeps_the_others"
    )) {
        return;
    }
    // Instead of ending the process.
    signal_hook::flag::register(SIGXFSZ, Arc::default()).unwrap();
    let folder = TempDir::new().unwrap();
    let mut outbox = open(folder.path());
    setrlimit(Resource::RLIMIT_FSIZE, LIMIT, LIMIT).unwrap();
    let mut refused = 0;
    for number in 0..20 {
        let stored = outbox.offer(message("pose", number, 10_000), NOW);
        refused += u64::from(stored.is_err());
    }
    assert!(refused > 0, "no file was too long");
    outbox.connect();
    assert_eq!(hand_over(&mut outbox).len() as u64, 20 - refused);
    let counts = outbox.counts();
    assert_eq!(
        (counts.handed_over, counts.refused),
        (20 - refused, refused)
    );
    // After the damage, a restart finds what is before it.
    drop(outbox);
    for file in files(folder.path()) {
        let len = fs::metadata(folder.path().join(&file)).unwrap().len();
        assert!(len < LIMIT, "{file} ends with a part of a message");
    }
    open(folder.path());
}
