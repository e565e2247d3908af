//! Long messages are read from the bag to the memory that subscribers read.

use std::fs;
use std::os::fd::AsFd;
use std::path::Path;
use std::slice;
use std::time::Duration;

use sm2_bag::{
    Bag, Compression, Filter, Options, PlayError, PlayOptions, PlayReport, Player, ReadError,
};
use sm2_node::{Name, Node, Shutdown, Subscriber};
use sm2_test_support::below;

use crate::common::{Domain, SOON, memory_folder, named, record};

/// Around the least length of messages that are chunks of their own, and long ones.
const LENS: &[usize] = if cfg!(feature = "slow") {
    &[10, 65_536, 65_537, 300_000, 1_000_001, 2_000_000]
} else {
    &[10, 65_536, 65_537, 300_000]
};
/// One bit of so many is changed before a payload: an odd number, so that each bit of a byte has its turn.
const BIT_STEP: usize = if cfg!(feature = "slow") { 1 } else { 5 };

/// A payload that only its length determines.
fn payload(len: usize) -> Vec<u8> {
    (0..len).map(|at| (at * 31 + at / 251) as u8).collect()
}

/// Records a message of each length.
fn record_images(domain: &Domain, sealed: bool, compression: Compression, lens: &[usize]) -> Bag {
    let camera = domain.node("camera");
    let images = camera.publisher_builder::<[u8]>("image").sealed(sealed);
    let images = images.reliable(true).publish_timeout(SOON);
    let images = images.declare().unwrap();
    let options = Options {
        compression,
        sync_interval: Duration::from_millis(1),
        reliable: [Name::new("image").unwrap()].into(),
        ..Options::new(named(&["image"]))
    };
    let node = domain.node("recorder");
    record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| images.links().iter().any(|it| it.open));
        for (number, len) in lens.iter().enumerate() {
            images.publish(&payload(*len)).unwrap();
            record_until(&mut |it| it.progress().messages > number as u64);
        }
    });
    Bag::open(&domain.path("bag")).unwrap()
}

/// Plays a bag, as fast as the subscribers take the messages.
fn play(bag: &Bag, domain: &Domain) -> Result<PlayReport, PlayError> {
    let options = PlayOptions {
        rate: 0.0,
        ..PlayOptions::default()
    };
    let shutdown = Shutdown::new().unwrap();
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    let bags = slice::from_ref(bag);
    Player::new(bags, options, connect, shutdown.as_fd())?.play()
}

fn subscriber(node: &Node, sealed: bool) -> Subscriber<[u8]> {
    let images = node.subscriber_builder::<[u8]>("image").depth(16);
    images.sealed(sealed).declare().unwrap()
}

/// The lengths of the messages that have come, whose bytes are checked.
fn received(images: &Subscriber<[u8]>) -> Vec<usize> {
    let samples = std::iter::from_fn(|| images.try_recv().unwrap());
    let lens = samples.map(|sample| {
        assert!(*sample == payload(sample.len()), "{} bytes", sample.len());
        sample.len()
    });
    lens.collect()
}

#[test]
fn long_messages_are_played_as_they_were_recorded() {
    for (sealed, compression) in [
        (false, Compression::None),
        (true, Compression::None),
        (false, Compression::Zstd),
    ] {
        let recorded = Domain::new();
        let bag = record_images(&recorded, sealed, compression, LENS);
        // The links want both forms, one of them, or none.
        for forms in [&[false, true][..], &[false], &[true], &[]] {
            let domain = Domain::new();
            let node = domain.node("viewer");
            let viewers: Vec<_> = forms.iter().map(|it| subscriber(&node, *it)).collect();
            let report = play(&bag, &domain).unwrap();
            assert!(report.complete);
            assert_eq!(report.topics[0].messages, LENS.len() as u64);
            for viewer in &viewers {
                assert_eq!(received(viewer), LENS, "{sealed}, {forms:?}");
            }
        }
    }
}

/// Reads a bag, whose payloads must be as they were recorded. Returns their lengths.
fn read(path: &Path) -> Result<Vec<usize>, ReadError> {
    let bag = Bag::open(path)?;
    let mut lens = Vec::new();
    for message in bag.messages(&Filter::default()) {
        let message = message?;
        assert!(message.data == payload(message.data.len()));
        lens.push(message.data.len());
    }
    Ok(lens)
}

#[test]
fn a_damaged_long_message_is_never_published() {
    let recorded = Domain::new();
    let lens = [10, 70_000, 80_000];
    let bag = record_images(&recorded, false, Compression::None, &lens);
    let bytes = fs::read(bag.path()).unwrap();
    let first = payload(70_000);
    let at = bytes.windows(first.len()).position(|it| it == first);
    let at = at.unwrap();
    let folder = memory_folder();
    let path = folder.path().join("damaged");
    let change = |place: usize, bit: usize| {
        let mut damaged = bytes.clone();
        damaged[place] ^= 1 << bit;
        fs::write(&path, &damaged).unwrap();
    };
    // All bits of the heads before the payload, and some of the payload.
    let heads = (at - 80..at).flat_map(|place| (0..8).map(move |bit| (place, bit)));
    let heads = heads.skip(below(BIT_STEP)).step_by(BIT_STEP);
    let inside = [0, 1, 35_000, 69_999].map(|it| (at + it, it % 8));
    let mut failed = 0;
    for (place, bit) in heads.chain(inside) {
        change(place, bit);
        match read(&path) {
            // The times of the chunk and the compressed length are not those of the message.
            Ok(found) => assert_eq!(found, lens, "byte {place} - {at}, bit {bit}"),
            Err(error) => {
                assert!(matches!(error, ReadError::Damaged { .. }), "{error}");
                failed += 1;
            }
        }
    }
    assert!(failed > 300 / BIT_STEP, "{failed}");

    for place in [at - 30, at, at + 69_999] {
        change(place, 3);
        let domain = Domain::new();
        let node = domain.node("viewer");
        let viewer = subscriber(&node, false);
        let played = play(&Bag::open(&path).unwrap(), &domain).unwrap();
        let [part] = &played.damaged[..] else {
            panic!("{played:?}");
        };
        assert!(part.reason.contains("CRC"), "{part}");
        assert_eq!(received(&viewer), [lens[0], lens[2]]);
    }

    // A message that is not chosen is verified as well: its channel may be the damage.
    change(at, 3);
    let damaged = Bag::open(&path).unwrap();
    let other = Filter {
        topics: ["other".to_owned()].into(),
        ..Filter::default()
    };
    let read: Vec<_> = damaged.messages(&other).collect();
    assert!(
        matches!(&read[..], [Err(ReadError::Damaged { .. })]),
        "{read:?}"
    );
}
