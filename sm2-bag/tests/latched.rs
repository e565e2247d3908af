//! Files that begin in the middle of a recording begin with the latched state.

use std::collections::BTreeSet;
use std::fs;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

use sm2_bag::{
    Bag, BagMessage, Compression, Filter, Folder, Options, Recorder, Report, Split, TopicReport,
    check, copy, diff, recover,
};
use sm2_node::{Node, Publisher, Shutdown};

use crate::common::{Domain, named, until};

const DATA_LEN: usize = 10_000;
const SPLIT: Split = Split {
    bytes: Some(100_000),
    time: None,
};

/// A recording of the topics `map`, `calibration` and `data` into a folder.
struct Recording<'fd> {
    recorder: Recorder<'fd>,
    data: Publisher<[u8]>,
    /// How many messages were published.
    messages: u64,
    _node: Node,
}

impl<'fd> Recording<'fd> {
    fn start(domain: &Domain, folder: Folder, options: Options, stop: &'fd Shutdown) -> Self {
        let node = domain.node("talker");
        let data = node.publisher_builder::<[u8]>("data");
        let recorder = domain.node("recorder");
        let mut recording = Self {
            recorder: Recorder::start_in(&recorder, folder, SPLIT, options, stop.as_fd()).unwrap(),
            data: data.reliable(true).declare().unwrap(),
            messages: 0,
            _node: node,
        };
        recording.until("the recorder is linked", |it| {
            it.data.links().iter().any(|link| link.open)
        });
        recording
    }

    fn until(&mut self, what: &str, mut done: impl FnMut(&Self) -> bool) {
        until(what, || {
            self.recorder.step(Duration::from_millis(1)).unwrap();
            done(self)
        });
    }

    /// Publishes a message, and waits until it is in a file.
    fn publish(&mut self, publisher: &Publisher<[u8]>, message: &[u8]) {
        publisher.publish(message).unwrap();
        self.messages += 1;
        self.until("the message is written", |it| {
            it.recorder.progress().messages == it.messages
        });
    }

    /// Publishes about as many messages as two files have.
    fn fill_two_files(&mut self) {
        for _ in 0..20 {
            self.data.publish(&[0; DATA_LEN]).unwrap();
            self.messages += 1;
            self.until("the message is written", |it| {
                it.recorder.progress().messages == it.messages
            });
        }
    }
}

fn options() -> Options {
    Options {
        reliable: BTreeSet::from(["data".parse().unwrap()]),
        ..Options::new(named(&["map", "calibration", "data"]))
    }
}

/// A publisher that keeps its last messages for late subscribers.
pub(crate) fn latched(node: &Node, topic: &str, messages: u16) -> Publisher<[u8]> {
    let publisher = node.publisher_builder::<[u8]>(topic);
    publisher
        .latched(messages)
        .reliable(true)
        .declare()
        .unwrap()
}

/// The bags of a folder in the order of their names. None of them has damage.
pub(crate) fn bags(folder: &Path) -> Vec<Bag> {
    let entries = fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|it| it.unwrap().path()).collect();
    paths.sort();
    for path in &paths {
        assert_eq!(check(path).unwrap().damages, [], "{}", path.display());
    }
    paths.iter().map(|it| Bag::open(it).unwrap()).collect()
}

pub(crate) fn messages(bag: &Bag) -> Vec<BagMessage> {
    let messages = bag.messages(&Filter::default());
    messages.map(Result::unwrap).collect()
}

/// The payloads of the repeated messages that a bag begins with, and the topics of all others.
pub(crate) fn parts(bag: &Bag) -> (Vec<Vec<u8>>, Vec<String>) {
    let messages = messages(bag);
    let (repeated, others): (Vec<_>, Vec<_>) =
        messages.into_iter().partition(BagMessage::is_repeated);
    let first = others.iter().map(|it| it.log_time).min();
    for it in &repeated {
        assert!(it.publish_time < it.log_time && Some(it.log_time) <= first);
    }
    (
        repeated.into_iter().map(|it| it.data).collect(),
        others
            .into_iter()
            .map(|it| it.channel.topic.clone())
            .collect(),
    )
}

fn topic<'a>(report: &'a Report, name: &str) -> &'a TopicReport {
    let mut topics = report.topics.iter();
    topics.find(|it| it.name == name).unwrap()
}

/// Two latched topics in the first of several files. Returns the report of the recording.
pub(crate) fn record_in(domain: &Domain, folder: Folder) -> Report {
    let stop = Shutdown::new().unwrap();
    let mapper = domain.node("mapper");
    let map = latched(&mapper, "map", 1);
    let calibration = latched(&mapper, "calibration", 2);
    let mut recording = Recording::start(domain, folder, options(), &stop);
    for message in [b"old", b"map"] {
        recording.publish(&map, message);
    }
    for message in [b"a", b"b", b"c"] {
        recording.publish(&calibration, message);
    }
    recording.fill_two_files();
    recording.fill_two_files();
    recording.recorder.finish().unwrap()
}

#[test]
fn each_file_begins_with_the_latched_state() {
    let domain = Domain::new();
    let path = domain.path("drive");
    let report = record_in(&domain, Folder::new(&path, "bag").unwrap());
    let bags = bags(&path);
    assert!(bags.len() > 3, "{} files", bags.len());
    for (number, bag) in bags.iter().enumerate() {
        let (mut repeated, others) = parts(bag);
        repeated.sort();
        let expected: &[&[u8]] = match number {
            0 => &[],
            _ => &[b"b", b"c", b"map"],
        };
        assert_eq!(repeated, expected, "file {number}");
        assert_eq!(others.iter().any(|it| it == "map"), number == 0);
        let its = bag.report();
        assert_eq!(topic(&its, "map").repeated, u64::from(number > 0));
        assert_eq!(topic(&its, "map").messages, if number == 0 { 2 } else { 0 });
    }
    // The counts of the recording have each message once.
    for (name, messages) in [("map", 2), ("calibration", 3), ("data", 40)] {
        let topic = topic(&report, name);
        assert_eq!(
            (topic.messages, topic.lost, topic.not_repeated),
            (messages, 0, 0)
        );
    }
}

#[test]
fn the_files_of_a_recording_together_have_each_message_once() {
    let domain = Domain::new();
    let path = domain.path("drive");
    record_in(&domain, Folder::new(&path, "bag").unwrap());
    let bags = bags(&path);
    let merged = |name: &str, from: usize| {
        let to = domain.path(name);
        copy(&bags[from..], &to, &Filter::default(), Compression::None).unwrap();
        assert_eq!(check(&to).unwrap().damages, []);
        Bag::open(&to).unwrap()
    };
    let whole = merged("whole", 0);
    assert_eq!(parts(&whole).0, Vec::<Vec<u8>>::new());
    assert_eq!(messages(&whole).len(), 45);
    // Without the first file, the state is there once, and counts and comparisons do not see it.
    let rest = merged("rest", 1);
    let (mut repeated, others) = parts(&rest);
    repeated.sort();
    assert_eq!(repeated, [b"b".to_vec(), b"c".to_vec(), b"map".to_vec()]);
    assert!(others.iter().all(|it| it == "data"));
    assert_eq!(topic(&rest.report(), "map").messages, 0);
    let filter = Filter {
        topics: BTreeSet::from(["data".to_owned()]),
        ..Filter::default()
    };
    let only_data = domain.path("only-data");
    copy(&bags[1..], &only_data, &filter, Compression::None).unwrap();
    let comparison = diff([&rest, &Bag::open(&only_data).unwrap()]).unwrap();
    assert_eq!(comparison.difference, None);
    // A recovered file keeps the marks.
    let recovered = domain.path("recovered");
    recover(rest.path(), &recovered).unwrap();
    assert_eq!(messages(&Bag::open(&recovered).unwrap()), messages(&rest));
}

#[test]
fn a_ring_that_has_lost_its_first_file_has_the_state() {
    let domain = Domain::new();
    let path = domain.path("ring");
    let folder = Folder::new(&path, "bag").unwrap();
    record_in(&domain, folder.keep_bytes(250_000, "bag").unwrap());
    let bags = bags(&path);
    assert!(!bags[0].path().ends_with("bag-0001.mcap"));
    assert_eq!(parts(&bags[0]).0.len(), 3);
}

#[test]
fn a_publisher_that_has_left_is_not_repeated() {
    let domain = Domain::new();
    let path = domain.path("drive");
    let stop = Shutdown::new().unwrap();
    let mapper = domain.node("mapper");
    let map = latched(&mapper, "map", 1);
    let folder = Folder::new(&path, "bag").unwrap();
    let mut recording = Recording::start(&domain, folder, options(), &stop);
    recording.publish(&map, b"map");
    recording.fill_two_files();
    drop(map);
    let files = || fs::read_dir(&path).unwrap().count();
    // The recorder learns it at the end of an interval.
    until("a file begins without the map", || {
        recording.fill_two_files();
        let last = path.join(format!("bag-{:04}.mcap", files() - 1));
        messages(&Bag::open(&last).unwrap())
            .iter()
            .all(|it| it.channel.topic != "map")
    });
    recording.recorder.finish().unwrap();
    let bags = bags(&path);
    assert_eq!(parts(&bags[1]).0, [b"map".to_vec()]);
    assert_eq!(parts(&bags[bags.len() - 1]).0, Vec::<Vec<u8>>::new());
}

/// The counts of a topic: repeated messages, and those without room.
fn counts_of(bag: &Bag, name: &str) -> (u64, u64) {
    let report = bag.report();
    let topic = topic(&report, name);
    (topic.repeated, topic.not_repeated)
}

#[test]
fn a_file_says_which_latched_messages_it_has_no_room_for() {
    // Half of a file, and a quarter of the budget.
    for (budget_bytes, fits, is_too_long) in
        [(256 << 20, 49_996, 50_001), (160_000, 39_996, 40_001)]
    {
        let domain = Domain::new();
        let path = domain.path("drive");
        let stop = Shutdown::new().unwrap();
        let mapper = domain.node("mapper");
        let (map, calibration) = (
            latched(&mapper, "map", 1),
            latched(&mapper, "calibration", 1),
        );
        let options = Options {
            budget_bytes,
            ..options()
        };
        let folder = Folder::new(&path, "bag").unwrap();
        let mut recording = Recording::start(&domain, folder, options, &stop);
        recording.publish(&map, &vec![1; is_too_long]);
        recording.fill_two_files();
        recording.publish(&map, &vec![2; fits]);
        recording.publish(&calibration, b"short");
        recording.fill_two_files();
        let report = recording.recorder.finish().unwrap();
        let bags = bags(&path);
        assert_eq!(counts_of(&bags[1], "map"), (0, 1));
        let last = &bags[bags.len() - 1];
        assert_eq!(
            counts_of(last, "map").0 + counts_of(last, "calibration").0,
            1,
            "one of both fits"
        );
        assert!(topic(&report, "map").not_repeated > 0);
        // The same in a copy, which names it once.
        let to = domain.path("copy");
        let copied = copy(&bags[1..], &to, &Filter::default(), Compression::None).unwrap();
        assert_eq!(topic(&copied, "map").not_repeated, 1);
    }
}

#[test]
fn a_copy_from_a_time_begins_with_the_state_as_of_then() {
    let domain = Domain::new();
    let path = domain.path("drive");
    let stop = Shutdown::new().unwrap();
    let mapper = domain.node("mapper");
    let map = latched(&mapper, "map", 2);
    let folder = Folder::new(&path, "bag").unwrap();
    let mut recording = Recording::start(&domain, folder, options(), &stop);
    for number in 0..6 {
        // A long one is a chunk of its own.
        let len = if number % 2 == 0 { 10 } else { 70_000 };
        recording.publish(&map, &vec![number; len]);
        recording.fill_two_files();
    }
    recording.recorder.finish().unwrap();
    let mut bags = bags(&path);
    let all: Vec<_> = bags.iter().flat_map(messages).collect();
    let maps = all
        .iter()
        .filter(|it| it.channel.topic == "map" && !it.is_repeated());
    let times: Vec<_> = maps.map(|it| it.log_time).collect();
    // The order of the bags does not matter.
    bags.reverse();
    for (last, time) in times.iter().enumerate() {
        let filter = Filter {
            from_ns: Some(time + 1),
            ..Filter::default()
        };
        let to = domain.path(&format!("from-{last}"));
        copy(&bags, &to, &filter, Compression::Lz4).unwrap();
        assert_eq!(check(&to).unwrap().damages, []);
        let bag = Bag::open(&to).unwrap();
        let numbers: Vec<_> = parts(&bag).0.iter().map(|it| usize::from(it[0])).collect();
        assert!(
            numbers.into_iter().eq(last.saturating_sub(1)..=last),
            "{last}"
        );
        assert!(messages(&bag).iter().all(|it| it.log_time > *time));
    }
}
