//! The first difference of two bags is found.

use std::collections::BTreeMap;
use std::io::BufWriter;
use std::path::Path;

use mcap::records::MessageHeader;
use sm2_bag::{Bag, Difference, diff};

/// A bag with these messages: topic, time, payload.
fn bag(folder: &Path, name: &str, messages: &[(&str, u64, &[u8])]) -> Bag {
    let path = folder.join(name);
    let file = BufWriter::new(std::fs::File::create(&path).unwrap());
    let mut writer = mcap::Writer::new(file).unwrap();
    for (topic, log_time, data) in messages {
        let channel_id = writer.add_channel(0, topic, "", &BTreeMap::new()).unwrap();
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: *log_time,
            publish_time: 0,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    Bag::open(&path).unwrap()
}

#[test]
fn the_first_difference_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let first: [(&str, u64, &[u8]); 4] = [
        ("scan", 1, b"one"),
        ("image", 2, b"left"),
        ("scan", 3, b"two"),
        ("image", 4, b"right"),
    ];
    let open = bag(folder, "first", &first);

    // Other times, and another order of the topics.
    let mut other = [first[1], first[3], first[0], first[2]];
    for (time, message) in other.iter_mut().enumerate() {
        message.1 = 10 * time as u64;
    }
    let same = bag(folder, "same", &other);
    assert_eq!(diff([&open, &same]).unwrap().difference, None);
    assert_eq!(diff([&same, &open]).unwrap().difference, None);

    let changed = |at: usize, data: &'static [u8]| {
        let mut messages = first;
        messages[at].2 = data;
        bag(folder, "changed", &messages)
    };
    let payload = |topic: &str, message, byte| {
        let topic = topic.to_owned();
        Some(Difference::Payload {
            topic,
            message,
            byte,
        })
    };
    for (at, data, difference) in [
        (0, &b"onE"[..], payload("scan", 0, 2)),
        (0, b"", payload("scan", 0, 0)),
        (2, b"twofold", payload("scan", 1, 3)),
        (3, b"Right", payload("image", 1, 0)),
    ] {
        assert_eq!(
            diff([&open, &changed(at, data)]).unwrap().difference,
            difference
        );
    }

    let shorter = bag(folder, "shorter", &first[..3]);
    let count = |only_in| {
        let topic = "image".to_owned();
        Some(Difference::Count {
            topic,
            message: 1,
            only_in,
        })
    };
    assert_eq!(diff([&open, &shorter]).unwrap().difference, count(0));
    assert_eq!(diff([&shorter, &open]).unwrap().difference, count(1));

    let without = bag(folder, "without", &[first[0], first[2]]);
    let topic = |only_in| {
        let topic = "image".to_owned();
        Some(Difference::Topic { topic, only_in })
    };
    assert_eq!(diff([&open, &without]).unwrap().difference, topic(0));
    assert_eq!(diff([&without, &open]).unwrap().difference, topic(1));
}
