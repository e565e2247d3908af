//! Bags of other programs have equal contents through every kind of work with bags.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::slice;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;

use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use sm2_bag::{
    Bag, BagFiles, Compression, Damage, Filter, PlayOptions, Player, ReadError, Report, check,
    copy, diff, messages, recover,
};
use sm2_node::{Name, Node, Shutdown, TypeId};

use crate::common::{Domain, SOON, memory_folder, picture};

const STRING: &str = "std_msgs/msg/String";
const MESSAGES: u64 = 30;

static REPLAYS: AtomicU32 = AtomicU32::new(0);

/// How a bag is written.
#[derive(Clone, Copy, Debug)]
struct Kind {
    compression: Option<mcap::Compression>,
    has_chunks: bool,
    /// Chunks of two messages, where each second one comes early.
    overlap: bool,
    index: Index,
}

/// The content of the summary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Index {
    All,
    NoStatistics,
    NoMessageIndexes,
    NoRepeatedChannels,
    /// There is no summary.
    None,
}

/// How the writer of the crate `mcap` can write a bag.
fn kinds() -> Vec<Kind> {
    let mut kinds = Vec::new();
    for index in [
        Index::All,
        Index::NoStatistics,
        Index::NoMessageIndexes,
        Index::NoRepeatedChannels,
        Index::None,
    ] {
        for compression in [
            None,
            Some(mcap::Compression::Lz4),
            Some(mcap::Compression::Zstd),
        ] {
            for overlap in [false, true] {
                kinds.push(Kind {
                    compression,
                    has_chunks: true,
                    overlap,
                    index,
                });
            }
        }
        kinds.push(Kind {
            compression: None,
            has_chunks: false,
            overlap: true,
            index,
        });
    }
    kinds
}

impl Kind {
    fn writer(self, path: &Path) -> Writer<File> {
        let has = |other| self.index != other;
        let options = WriteOptions::new()
            .profile("ros2")
            .compression(self.compression)
            .use_chunks(self.has_chunks)
            .chunk_size(Some(if self.overlap { 60 } else { 200 }))
            .emit_statistics(has(Index::NoStatistics))
            .emit_message_indexes(has(Index::NoMessageIndexes))
            .repeat_channels(has(Index::NoRepeatedChannels));
        let options = match self.index {
            Index::None => options
                .emit_summary_records(false)
                .emit_summary_offsets(false),
            _ => options,
        };
        options.create(File::create(path).unwrap()).unwrap()
    }

    /// The numbers of the messages in the order of the file.
    fn order(self) -> Vec<u64> {
        let mut order: Vec<_> = (0..MESSAGES).collect();
        if self.overlap {
            order.chunks_mut(10).for_each(<[_]>::reverse);
            order.swap(0, MESSAGES as usize - 1);
        }
        order
    }
}

/// A message in CDR: the text `number`.
fn message(number: u64) -> Vec<u8> {
    let text = format!("{number}\0");
    let len = (text.len() as u32).to_le_bytes();
    [b"\0\x01\0\0", &len[..], text.as_bytes()].concat()
}

/// Writes a bag with topics of several types, one of them without messages, an attachment and a metadata record.
fn write(path: &Path, kind: Kind) {
    let mut writer = kind.writer(path);
    let text = writer
        .add_schema(STRING, "ros2msg", b"string data")
        .unwrap();
    let json = writer.add_schema("Other", "jsonschema", b"{}").unwrap();
    let none = BTreeMap::new();
    let channels = [
        writer.add_channel(text, "/text", "cdr", &none).unwrap(),
        writer.add_channel(json, "/json", "json", &none).unwrap(),
        writer.add_channel(0, "/raw", "", &none).unwrap(),
    ];
    writer.add_channel(text, "/silent", "cdr", &none).unwrap();
    for number in kind.order() {
        let header = MessageHeader {
            channel_id: channels[number as usize % channels.len()],
            sequence: number as u32,
            log_time: 1_000 + number,
            publish_time: 900 + number,
        };
        let data = message(number);
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.attach(&picture()).unwrap();
    let metadata = Metadata {
        name: "robot".to_owned(),
        metadata: [("name".to_owned(), "R2".to_owned())].into(),
    };
    writer.write_metadata(&metadata).unwrap();
    writer.finish().unwrap();
}

/// The topics with their types and counts.
fn counts(report: &Report) -> Vec<(String, String, u64)> {
    let topics = report.topics.iter();
    let topics = topics.map(|it| (it.name.clone(), it.r#type.name.clone(), it.messages));
    topics.collect()
}

fn expected_counts(times: u64) -> Vec<(String, String, u64)> {
    let each = MESSAGES / 3 * times;
    let topics = [
        ("/json", "Other", each),
        ("/raw", "", each),
        ("/silent", STRING, 0),
        ("/text", STRING, each),
    ];
    let topics = topics.map(|(name, data, messages)| (name.to_owned(), data.to_owned(), messages));
    topics.to_vec()
}

/// Times, topics and payloads in their order.
fn content(bags: &[Bag]) -> Vec<(u64, u64, u32, String, Vec<u8>)> {
    let all = messages(bags, &Filter::default()).map(|(_, it)| it.unwrap());
    let all = all.map(|it| {
        let topic = it.channel.topic.clone();
        (it.log_time, it.publish_time, it.sequence, topic, it.data)
    });
    all.collect()
}

/// A bag is as it was written: `info`, `check`, `filter`, `convert`, `merge`, `recover` and `diff`.
fn assert_equal_through_all(folder: &Path, path: &Path, kind: Kind) {
    let bag = Bag::open(path).unwrap();
    assert!(bag.is_complete(), "{kind:?}");
    assert_eq!(counts(&bag.report()), expected_counts(1), "{kind:?}");
    let has_bytes = bag.report().topics[0].bytes.is_some();
    let is_indexed = kind.has_chunks && kind.index == Index::All;
    assert_eq!(has_bytes, !is_indexed, "{kind:?}");
    assert_eq!(check(path).unwrap().damages, [], "{kind:?}");
    let bags = [bag];
    let all = content(&bags);
    let numbers = all.iter().map(|it| it.0 - 1_000);
    assert!(numbers.eq(0..MESSAGES), "{kind:?}");
    assert!(all.iter().all(|it| it.4 == message(it.0 - 1_000)));

    let [converted, recovered, merged, filtered] =
        ["converted", "recovered", "merged", "filtered"].map(|it| folder.join(it));
    let filter = Filter::default();
    copy(&bags, &converted, &filter, Compression::Zstd).unwrap();
    recover(path, &recovered).unwrap();
    for new in [&converted, &recovered] {
        let new = [Bag::open(new).unwrap()];
        assert_eq!(counts(&new[0].report()), expected_counts(1), "{kind:?}");
        assert_eq!(content(&new), all, "{kind:?}");
        assert_eq!(diff([&bags[0], &new[0]]).unwrap().difference, None);
        assert_eq!(check(new[0].path()).unwrap().damages, []);
        let bytes = fs::read(new[0].path()).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        let [index] = &summary.attachment_indexes[..] else {
            panic!("{kind:?}: {summary:?}");
        };
        let attachment = mcap::read::attachment(&bytes, index).unwrap();
        assert_eq!(&*attachment.data, b"a picture");
        let records = summary.metadata_indexes.iter();
        assert_eq!(records.filter(|it| it.name == "robot").count(), 1);
    }
    let twice = [path, path].map(|it| Bag::open(it).unwrap());
    let report = copy(&twice, &merged, &filter, Compression::Lz4).unwrap();
    assert_eq!(counts(&report), expected_counts(2), "{kind:?}");
    let filter = Filter {
        topics: ["text".to_owned()].into(),
        from_ns: Some(1_010),
        to_ns: Some(1_020),
        ..Filter::default()
    };
    copy(&bags, &filtered, &filter, Compression::None).unwrap();
    let chosen = all.into_iter();
    let chosen = chosen.filter(|it| it.3 == "/text" && (1_010..1_020).contains(&it.0));
    let filtered_bag = Bag::open(&filtered).unwrap();
    assert!(
        content(slice::from_ref(&filtered_bag))
            .into_iter()
            .eq(chosen)
    );
    for path in [converted, recovered, merged, filtered] {
        fs::remove_file(path).unwrap();
    }
}

#[test]
fn bags_of_the_crate_mcap_are_equal_through_all_work() {
    let folder = memory_folder();
    let path = folder.path().join("bag.mcap");
    let kinds = kinds();
    assert!(kinds.len() >= 20);
    for kind in kinds {
        write(&path, kind);
        assert_equal_through_all(folder.path(), &path, kind);
    }
}

fn string_type() -> TypeId {
    let bag = memory_folder();
    let path = bag.path().join("bag");
    write(&path, kinds()[0]);
    let bag = Bag::open(&path).unwrap();
    let sources: Vec<_> = bag.sources().flat_map(|it| it.1).collect();
    sources[0].data.clone()
}

/// Plays the topic of ROS 2, and returns the payloads that a subscriber received.
fn played(domain: &Domain, bags: &[Bag], data: &TypeId) -> Vec<Vec<u8>> {
    // The nodes of the replay before may not have left yet.
    let number = REPLAYS.fetch_add(1, Ordering::Relaxed);
    let listener = domain.node(&format!("listener{number}"));
    let texts = listener.subscriber_builder::<[u8]>("text").depth(64);
    let texts = texts
        .type_id(data.clone())
        .reliable(true)
        .declare()
        .unwrap();
    let shutdown = Shutdown::new().unwrap();
    let options = PlayOptions {
        rate: 0.0,
        filter: Filter {
            topics: ["text".to_owned()].into(),
            ..Filter::default()
        },
        subscribers: 1,
        name: Name::new(&format!("play{number}")).unwrap(),
        ..PlayOptions::default()
    };
    let connect = |name: &str| Node::builder(name).socket(domain.path("sock")).connect();
    let mut player = Player::new(bags, options, connect, shutdown.as_fd()).unwrap();
    let receive = thread::spawn(move || {
        let samples =
            (0..MESSAGES / 3).map(|_| texts.recv_timeout(SOON).unwrap().unwrap().to_vec());
        samples.collect()
    });
    assert!(player.play().unwrap().complete);
    receive.join().unwrap()
}

#[test]
fn bags_of_the_crate_mcap_are_played() {
    let domain = Domain::new();
    let path = domain.path("bag.mcap");
    let data = string_type();
    let expected: Vec<_> = (0..MESSAGES).step_by(3).map(message).collect();
    for kind in kinds().into_iter().step_by(2) {
        write(&path, kind);
        let bag = Bag::open(&path).unwrap();
        assert_eq!(played(&domain, &[bag], &data), expected, "{kind:?}");
    }
}

/// A folder as a recorder of ROS 2 leaves it: two files that it has compressed, or messages that it has compressed.
fn write_folder(folder: &Path, mode: &str) -> PathBuf {
    let bag = folder.join(mode);
    fs::create_dir(&bag).unwrap();
    let mut names = Vec::new();
    for part in 0..2 {
        let ending = if mode == "FILE" { "mcap.zstd" } else { "mcap" };
        let name = format!("{mode}_{part}.{ending}");
        let path = bag.join(&name);
        let mut writer = Writer::new(File::create(&path).unwrap()).unwrap();
        let schema = writer
            .add_schema(STRING, "ros2msg", b"string data")
            .unwrap();
        let channel_id = writer
            .add_channel(schema, "/text", "cdr", &BTreeMap::new())
            .unwrap();
        for number in 0..MESSAGES / 6 {
            let number = part * MESSAGES / 6 + number;
            let mut data = message(number);
            if mode == "MESSAGE" {
                data = zstd::encode_all(data.as_slice(), 0).unwrap();
            }
            let header = MessageHeader {
                channel_id,
                sequence: 0,
                log_time: number,
                publish_time: number,
            };
            writer.write_to_known_channel(&header, &data).unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        if mode == "FILE" {
            let bytes = fs::read(&path).unwrap();
            fs::write(&path, zstd::encode_all(bytes.as_slice(), 0).unwrap()).unwrap();
        }
        names.push(format!("    - {name}\n"));
    }
    // Files that the description does not name are not a part of the bag.
    fs::write(bag.join("other.mcap"), "no bag").unwrap();
    let yaml = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n{}  \
         compression_format: zstd\n  compression_mode: {mode}\n",
        names.concat()
    );
    fs::write(bag.join("metadata.yaml"), yaml).unwrap();
    bag
}

#[test]
fn a_folder_of_rosbag2_is_a_bag() {
    let domain = Domain::new();
    let data = string_type();
    let expected: Vec<_> = (0..MESSAGES / 3).map(message).collect();
    for mode in ["NONE", "FILE", "MESSAGE"] {
        let path = write_folder(domain.folder.path(), mode);
        let files = BagFiles::find(&path).unwrap();
        let bags = files
            .open(&mut |_| std::ops::ControlFlow::Continue(()))
            .unwrap();
        let reports: Vec<_> = bags.iter().map(Bag::report).collect();
        let report = Report::of_files(&reports);
        let text = ("/text".to_owned(), STRING.to_owned(), MESSAGES / 3);
        assert_eq!(counts(&report), [text], "{mode}");
        assert!(report.complete);
        let payloads = |bags: &[Bag]| -> Vec<_> {
            let content = content(bags).into_iter();
            content.map(|it| it.4).collect()
        };
        assert_eq!(payloads(&bags), expected, "{mode}");
        for path in files.paths() {
            assert_eq!(check(path).unwrap().damages, [], "{mode}");
        }
        let [copied, recovered] =
            ["copied", "recovered"].map(|it| domain.path(&format!("{mode}.{it}")));
        copy(&bags, &copied, &Filter::default(), Compression::None).unwrap();
        recover(&path, &recovered).unwrap();
        for new in [copied, recovered] {
            let new = [Bag::open(&new).unwrap()];
            assert_eq!(payloads(&new), expected, "{mode}");
        }
        assert_eq!(played(&domain, &bags, &data), expected, "{mode}");
        fs::remove_file(&files.paths()[1]).unwrap();
        let error = BagFiles::find(&path).unwrap();
        let error = error.open(&mut |_| std::ops::ControlFlow::Continue(()));
        assert!(error.unwrap_err().to_string().contains("_1.mcap"));
    }
}

/// A file alone can say that its messages are compressed. One that is not is damaged, and the others are read.
#[test]
fn a_message_that_is_not_compressed_as_it_should_be_is_damaged() {
    let folder = memory_folder();
    let [path, copied] = ["bag", "copied"].map(|it| folder.path().join(it));
    let mut writer = Writer::new(File::create(&path).unwrap()).unwrap();
    let channel_id = writer.add_channel(0, "/raw", "", &BTreeMap::new()).unwrap();
    for number in 0..3 {
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: number,
            publish_time: 0,
        };
        let data = message(number);
        let data = match number {
            1 => data,
            _ => zstd::encode_all(data.as_slice(), 0).unwrap(),
        };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    let yaml = "compression_format: zstd\ncompression_mode: message\n";
    let description = Metadata {
        name: "rosbag2".to_owned(),
        metadata: [("serialized_metadata".to_owned(), yaml.to_owned())].into(),
    };
    writer.write_metadata(&description).unwrap();
    writer.finish().unwrap();
    drop(writer);
    let bag = Bag::open(&path).unwrap();
    let read: Vec<_> = bag.messages(&Filter::default()).collect();
    let damaged = |at: usize| matches!(read[at], Err(ReadError::Damaged { .. }));
    assert_eq!([0, 1, 2].map(damaged), [false, true, false]);
    let damages = check(&path).unwrap().damages;
    assert!(
        matches!(damages[..], [Damage::Unreadable(_)]),
        "{damages:?}"
    );
    let report = copy(&[bag], &copied, &Filter::default(), Compression::None).unwrap();
    assert_eq!((report.topics[0].messages, report.damaged.len()), (2, 1));
    let payloads: Vec<_> = content(&[Bag::open(&copied).unwrap()]);
    let payloads = payloads.into_iter().map(|it| it.4);
    assert!(payloads.eq([0, 2].map(message)));
}
