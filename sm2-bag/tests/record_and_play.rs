//! The messages of a recording are in the bag, and are published again.

use std::os::fd::AsFd;
use std::slice;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use sm2_bag::{
    Bag, Compression, Filter, GapReason, Options, PlayError, PlayOptions, Player, Recorder, Step,
    Topics, check,
};
use sm2_node::{Message, Name, Node, Shutdown};

use crate::common::{Domain, SOON, named, record};

#[derive(Message, serde::Serialize, serde::Deserialize)]
#[message(name = "sensor/Scan", encoding = "postcard")]
struct Scan {
    ranges: Vec<f32>,
}

/// A payload that only its number and length determine.
fn payload(number: u32, len: usize) -> Vec<u8> {
    (0..len)
        .map(|at| (number as usize * 31 + at) as u8)
        .collect()
}

#[test]
fn a_bag_has_every_message_of_each_length() {
    let domain = Domain::new();
    for (name, compression) in [
        ("none", Compression::None),
        ("lz4", Compression::Lz4),
        ("zstd", Compression::Zstd),
    ] {
        let talker = domain.node("talker");
        let camera = talker.publisher_builder::<[u8]>("camera");
        let camera = camera
            .reliable(true)
            .publish_timeout(SOON)
            .declare()
            .unwrap();
        let options = Options {
            compression,
            reliable: [Name::new("camera").unwrap()].into(),
            ..Options::new(named(&["camera"]))
        };
        let recorder = domain.node("recorder");
        let lens = [0, 1, 64, 65_536, 65_537, 300_000, 2_000_000];
        let storage = domain.create(name);
        let report = record(&recorder, storage, options, |record_until| {
            record_until(&mut |_| camera.links().iter().any(|it| it.open));
            for (number, len) in lens.into_iter().enumerate() {
                let sent = payload(number as u32, len);
                record_until(&mut |_| camera.try_publish(&sent).unwrap().is_some());
            }
            record_until(&mut |it| it.progress().messages == lens.len() as u64);
        });
        assert!(report.complete);
        let topic = &report.topics[0];
        assert_eq!(
            (topic.name.as_str(), topic.r#type.name.as_str()),
            ("camera", "bytes")
        );
        assert_eq!((topic.messages, topic.lost), (lens.len() as u64, 0));
        assert_eq!(topic.bytes, Some(lens.iter().sum::<usize>() as u64));
        let path = domain.path(name);
        let bag = Bag::open(&path).unwrap();
        assert_eq!(bag.report(), report, "{name}");
        let messages = bag.messages(&Filter::default());
        let found: Vec<_> = messages.map(Result::unwrap).collect();
        for (number, len) in lens.into_iter().enumerate() {
            assert_eq!(found[number].sequence, number as u32 + 1);
            assert!(
                found[number].data == payload(number as u32, len),
                "{name}, {len} bytes"
            );
            assert!(found[number].publish_time <= found[number].log_time);
        }
        assert_eq!(check(&path).unwrap().damages, []);
    }
}

/// Receives five messages of both topics.
fn listen(node: &Node, ready: &mpsc::Sender<()>) -> Vec<(f32, String)> {
    let scans = node.subscriber_builder::<Scan>("scan");
    let scans = scans.depth(16).reliable(true).declare().unwrap();
    let text = node.subscriber_builder::<str>("old/chatter").depth(16);
    let text = text.declare().unwrap();
    ready.send(()).unwrap();
    let mut seen = Vec::new();
    for _ in 0..5 {
        let scan = scans.recv_timeout(SOON).unwrap().expect("a scan");
        let text = text.recv_timeout(SOON).unwrap().expect("a text");
        seen.push((scan.ranges[2], text.to_owned()));
        if seen.len() == 1 {
            assert_eq!(scan.publisher().as_str(), "play/talker");
        }
    }
    seen
}

#[test]
fn what_is_played_is_what_was_recorded() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let scans = talker.publisher_builder::<Scan>("scan");
    let scans = scans.reliable(true).latched(3).declare().unwrap();
    let text = talker.publisher::<str>("chatter").unwrap();
    let recorder = domain.node("recorder");
    let options = Options::new(Topics::All);
    let report = record(&recorder, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| {
            [scans.links(), text.links()]
                .iter()
                .all(|it| it.iter().any(|link| link.open))
        });
        for number in 0..5 {
            let ranges = vec![number as f32; 3];
            scans.publish(&Scan { ranges }).unwrap();
            text.publish(&format!("message {number}")).unwrap();
            record_until(&mut |it| it.progress().messages == 2 * (number + 1));
        }
    });
    assert_eq!(report.topics.len(), 2);
    drop((scans, text, talker, recorder));

    // A domain without any of these nodes: the types and schemas come from the bag.
    let other = Domain::new();
    let (ready, started) = mpsc::channel();
    let node = other.node("listener");
    let listener = thread::spawn(move || listen(&node, &ready));
    started.recv_timeout(SOON).unwrap();
    let bag = Bag::open(&domain.path("bag")).unwrap();
    let options = PlayOptions {
        rate: 0.0,
        remap: [(
            Name::new("chatter").unwrap(),
            Name::new("old/chatter").unwrap(),
        )]
        .into(),
        ..PlayOptions::default()
    };
    let shutdown = Shutdown::new().unwrap();
    let connect = |name: &str| Node::builder(name).socket(other.path("sock")).connect();
    let mut player =
        Player::new(slice::from_ref(&bag), options, connect, shutdown.as_fd()).unwrap();
    let played = player.play().unwrap();
    assert!(played.complete);
    let topics = played.topics.iter();
    let counts: Vec<_> = topics
        .map(|it| (it.name.as_str(), it.messages, it.unheard, it.missed))
        .collect();
    assert_eq!(counts, [("old/chatter", 5, 0, 0), ("scan", 5, 0, 0)]);
    let seen = listener.join().unwrap();
    for (number, (range, text)) in seen.into_iter().enumerate() {
        assert_eq!((range, text), (number as f32, format!("message {number}")));
    }
}

#[test]
fn a_player_ends_when_it_is_told_to() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let text = talker.publisher::<str>("chatter").unwrap();
    let recorder = domain.node("recorder");
    let options = Options::new(named(&["chatter"]));
    record(&recorder, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| text.links().iter().any(|it| it.open));
        for number in 1..=2 {
            text.publish("hello").unwrap();
            record_until(&mut |it| it.progress().messages == number);
        }
    });
    let bag = Bag::open(&domain.path("bag")).unwrap();
    // The second message is due in some hundred years.
    let slow = PlayOptions {
        rate: 1e-12,
        ..PlayOptions::default()
    };
    let shutdown = Shutdown::new().unwrap();
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    let mut player = Player::new(slice::from_ref(&bag), slow, connect, shutdown.as_fd()).unwrap();
    thread::scope(|scope| {
        scope.spawn(|| {
            thread::sleep(Duration::from_millis(50));
            shutdown.request();
        });
        let played = player.play().unwrap();
        assert!(!played.complete);
        assert!(played.topics[0].messages < 2);
    });
    let none = PlayOptions {
        filter: Filter {
            topics: ["scan".to_owned()].into(),
            ..Filter::default()
        },
        ..PlayOptions::default()
    };
    let refused = Player::new(slice::from_ref(&bag), none, connect, shutdown.as_fd()).err();
    assert!(
        matches!(refused, Some(PlayError::Empty { .. })),
        "{refused:?}"
    );
}

#[test]
fn messages_that_newer_ones_displaced_are_a_gap() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let fast = talker.publisher::<u64>("fast").unwrap();
    let recorder = domain.node("recorder");
    let options = Options::new(named(&["fast"]));
    let report = record(&recorder, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| fast.links().iter().any(|it| it.open));
        fast.publish(&0).unwrap();
        record_until(&mut |it| it.progress().messages == 1);
        // More than wait for the recorder, which does not run meanwhile.
        for number in 1..=1_000 {
            fast.publish(&number).unwrap();
        }
        record_until(&mut |it| it.progress().messages + it.progress().lost == 1_001);
    });
    let topic = &report.topics[0];
    assert_eq!(topic.messages + topic.lost, 1_001);
    assert_eq!(topic.gaps.len(), 1);
    let gap = &topic.gaps[0];
    assert_eq!(
        (gap.reason, gap.messages),
        (GapReason::Displaced, topic.lost)
    );
    assert!(gap.messages > 0 && gap.from_ns < gap.to_ns);
    assert_eq!(gap.publisher, "talker");
    assert_eq!(Bag::open(&domain.path("bag")).unwrap().report(), report);
}

#[test]
fn a_recorder_is_told_by_its_descriptor_to_end() {
    let domain = Domain::new();
    let node = domain.node("recorder");
    let shutdown = Shutdown::new().unwrap();
    let storage = domain.create("bag");
    let options = Options::new(named(&["nothing"]));
    let mut recorder = Recorder::start(&node, storage, options, shutdown.as_fd()).unwrap();
    let step = recorder.step(Duration::from_millis(1)).unwrap();
    assert_ne!(step, Step::Stopped);
    shutdown.request();
    // The recorder's own subscriber may have changed the domain.
    while recorder.step(SOON).unwrap() == Step::Woken {}
    assert_eq!(recorder.step(SOON).unwrap(), Step::Stopped);
    let report = recorder.finish().unwrap();
    assert!(report.complete && report.topics.is_empty());
    assert_eq!((report.start_ns, report.end_ns), (None, None));
}
