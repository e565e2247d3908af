//! Copies of bags have the chosen messages, in their order.

use std::fs;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::Duration;

use sm2_bag::{Bag, Compression, CopyError, Filter, GapReason, Options, check, copy, recover};

use crate::common::{Domain, named, record};

const COMPRESSIONS: [Compression; 3] = [Compression::None, Compression::Lz4, Compression::Zstd];

/// Records the numbers on the topics `even` and `odd`.
fn record_numbers(domain: &Domain, name: &str, numbers: std::ops::Range<u64>) {
    let talker = domain.node("talker");
    let topics = ["even", "odd"].map(|it| talker.publisher::<u64>(it).unwrap());
    let options = Options {
        sync_interval: Duration::from_millis(1),
        ..Options::new(named(&["even", "odd"]))
    };
    let node = domain.node("recorder");
    record(&node, domain.create(name), options, |record_until| {
        record_until(&mut |_| {
            let is_open = |it: &sm2_node::Publisher<u64>| it.links().iter().any(|it| it.open);
            topics.iter().all(is_open)
        });
        for (index, number) in numbers.enumerate() {
            topics[number as usize % 2].publish(&number).unwrap();
            record_until(&mut |it| it.progress().messages > index as u64);
        }
    });
}

/// The topics, times and numbers of all messages.
fn messages(path: &Path) -> Vec<(String, u64, u64)> {
    let bag = Bag::open(path).unwrap();
    let messages = bag.messages(&Filter::default());
    let read = messages.map(|it| {
        let it = it.unwrap();
        let number = u64::from_le_bytes(it.data.try_into().unwrap());
        (it.channel.topic.clone(), it.log_time, number)
    });
    read.collect()
}

fn assert_whole(path: &Path) {
    let verdict = check(path).unwrap();
    assert_eq!(verdict.damages, []);
    assert!(verdict.report.complete);
}

#[test]
fn a_copy_has_the_messages_of_the_filter() {
    let domain = Domain::new();
    record_numbers(&domain, "bag", 0..20);
    let all = messages(&domain.path("bag"));
    assert_eq!(all.len(), 20);
    let bags = [Bag::open(&domain.path("bag")).unwrap()];
    let to = domain.path("copy");
    for compression in COMPRESSIONS {
        let filter = Filter {
            topics: ["odd".to_owned()].into(),
            from_ns: Some(all[4].1),
            to_ns: Some(all[15].1),
            ..Filter::default()
        };
        let report = copy(&bags, &to, &filter, compression).unwrap();
        let chosen: Vec<_> = all[4..15].iter().filter(|it| it.0 == "odd").collect();
        assert_eq!(messages(&to).iter().collect::<Vec<_>>(), chosen);
        assert_eq!(report.topics.len(), 1);
        assert_eq!(report.topics[0].messages, 5);
        assert_whole(&to);
        // The publisher is in the copy.
        let (copied, original) = (Bag::open(&to).unwrap(), &bags[0]);
        let source = copied.sources().next().unwrap().1.unwrap();
        assert!(original.sources().any(|it| it.1.as_ref() == Ok(&source)));
        assert_eq!(copied.clocks(), original.clocks());
        fs::remove_file(&to).unwrap();
    }
}

#[test]
fn merged_bags_have_one_order_and_one_channel_for_each_publisher() {
    let domain = Domain::new();
    record_numbers(&domain, "first", 0..10);
    record_numbers(&domain, "second", 10..20);
    let paths = ["first", "second"].map(|it| domain.path(it));
    // Also a bag whose times overlap with the others: its copy.
    let bags = [&paths[1], &paths[0], &paths[1]].map(|it| Bag::open(it).unwrap());
    let to = domain.path("merged");
    let report = copy(&bags, &to, &Filter::default(), Compression::Zstd).unwrap();
    let mut expected = messages(&paths[0]);
    for message in messages(&paths[1]) {
        expected.extend([message.clone(), message]);
    }
    assert_eq!(messages(&to), expected);
    assert_eq!(Bag::open(&to).unwrap().sources().count(), 2);
    let counts: Vec<_> = report.topics.iter().map(|it| it.messages).collect();
    assert_eq!(counts, [15, 15]);
    assert_whole(&to);
}

#[test]
fn a_copy_has_the_gaps_of_its_topics_and_times() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let topics = ["image", "scan"].map(|it| talker.publisher::<[u8]>(it).unwrap());
    let options = Options {
        budget_bytes: 1_000,
        ..Options::new(named(&["image", "scan"]))
    };
    let node = domain.node("recorder");
    record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| topics.iter().all(|it| it.links().iter().any(|it| it.open)));
        for topic in &topics {
            topic.publish(&[1; 10]).unwrap();
        }
        record_until(&mut |it| it.progress().messages == 2);
        topics[0].publish(&vec![2; 2_000]).unwrap();
        record_until(&mut |it| it.progress().lost == 1);
    });
    let bags = [Bag::open(&domain.path("bag")).unwrap()];
    let gap = bags[0].report().topics[0].gaps[0].clone();
    assert_eq!((gap.messages, gap.reason), (1, GapReason::Budget));
    for (topic, from_ns, to_ns, lost) in [
        ("image", None, None, 1),
        ("scan", None, None, 0),
        ("image", Some(gap.to_ns), None, 1),
        ("image", Some(gap.to_ns + 1), None, 0),
        ("image", None, Some(gap.from_ns + 1), 1),
        ("image", None, Some(gap.from_ns), 0),
    ] {
        let to = domain.path("copy");
        let topics = [topic.to_owned()].into();
        let filter = Filter {
            topics,
            from_ns,
            to_ns,
            ..Filter::default()
        };
        let report = copy(&bags, &to, &filter, Compression::None).unwrap();
        assert_eq!(report.topics[0].lost, lost, "{filter:?}");
        fs::remove_file(&to).unwrap();
    }
}

#[test]
fn a_copy_that_fails_leaves_nothing() {
    let domain = Domain::new();
    record_numbers(&domain, "bag", 0..20);
    let (from, to) = (domain.path("bag"), domain.path("copy"));
    let all = Filter::default();
    let bags = [Bag::open(&from).unwrap()];

    let filter = Filter {
        topics: ["odd".to_owned(), "uneven".to_owned()].into(),
        ..Filter::default()
    };
    let refused = copy(&bags, &to, &filter, Compression::None);
    assert!(matches!(refused, Err(CopyError::NoTopic { topic }) if topic == "uneven"));
    assert!(!to.exists());

    // The payload of a message is damaged after the bag was opened.
    let bytes = fs::read(&from).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let chunk = &summary.chunk_indexes[0];
    let payload = chunk.chunk_start_offset + chunk.chunk_length - 8;
    let file = fs::OpenOptions::new().write(true).open(&from).unwrap();
    file.write_all_at(&[0xFF; 8], payload).unwrap();
    let damaged = copy(&bags, &to, &all, Compression::None).unwrap().damaged;
    let places: Vec<_> = damaged.iter().map(|it| (it.offset, it.bytes)).collect();
    assert_eq!(places, [(chunk.chunk_start_offset, chunk.chunk_length)]);
    fs::remove_file(&to).unwrap();

    // A file that exists stays as it is.
    fs::write(&to, "a letter").unwrap();
    let taken = copy(&bags, &to, &all, Compression::None);
    assert!(matches!(taken, Err(CopyError::Write { .. })), "{taken:?}");
    assert_eq!(fs::read_to_string(&to).unwrap(), "a letter");
}

#[test]
fn messages_outside_of_chunks_are_read_as_others() {
    let domain = Domain::new();
    let [loose, to, whole] = ["loose", "copy", "whole"].map(|it| domain.path(it));
    let file = domain.create("loose");
    let mut writer = mcap::WriteOptions::new()
        .use_chunks(false)
        .create(std::io::BufWriter::new(file))
        .unwrap();
    let channel = writer
        .add_channel(0, "numbers", "plain", &Default::default())
        .unwrap();
    for number in 0..3_u32 {
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: number,
            log_time: number.into(),
            publish_time: number.into(),
        };
        let data = u64::from(number).to_le_bytes();
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let bag = Bag::open(&loose).unwrap();
    assert_eq!(bag.report().topics[0].messages, 3);
    assert_eq!(check(&loose).unwrap().damages, []);
    let copied = copy(&[bag], &to, &Filter::default(), Compression::None).unwrap();
    assert_eq!(copied.topics[0].messages, 3);
    let numbers: Vec<_> = messages(&to).into_iter().map(|it| it.2).collect();
    assert_eq!(numbers, [0, 1, 2]);
    recover(&loose, &whole).unwrap();
    let numbers: Vec<_> = messages(&whole).into_iter().map(|it| it.2).collect();
    assert_eq!(numbers, [0, 1, 2]);
}
