use std::io::Cursor;

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use super::*;
use crate::bag::Bag;

const CHUNKS: u64 = 8;
const MESSAGES: u64 = 40;
const LEN: usize = 10_000;

/// A payload that a compression makes short.
fn payload(time: u64) -> Vec<u8> {
    [time.to_le_bytes().to_vec(), vec![0; LEN]].concat()
}

/// Writes a bag whose chunks overlap: each has a message of each time span, and those of the first chunk are not in
/// order.
fn overlapping(path: &Path, compression: Option<mcap::Compression>) {
    let options = WriteOptions::new()
        .compression(compression)
        .chunk_size(None);
    let mut writer: Writer<_> = options.create(Cursor::new(Vec::new())).unwrap();
    let channel_id = writer.add_channel(0, "numbers", "", &BTreeMap::new());
    let channel_id = channel_id.unwrap();
    for chunk in 0..CHUNKS {
        let mut times: Vec<_> = (0..MESSAGES).map(|it| it * CHUNKS + chunk).collect();
        if chunk == 0 {
            times.reverse();
        }
        for time in times {
            let header = MessageHeader {
                channel_id,
                sequence: 0,
                log_time: time,
                publish_time: 0,
            };
            writer
                .write_to_known_channel(&header, &payload(time))
                .unwrap();
        }
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    std::fs::write(path, writer.into_inner().into_inner()).unwrap();
}

const COMPRESSIONS: [Option<mcap::Compression>; 3] = [
    None,
    Some(mcap::Compression::Lz4),
    Some(mcap::Compression::Zstd),
];

/// Chunks are read again instead of keeping everything that is not due yet.
#[test]
fn overlapping_chunks_have_a_limit_of_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag");
    for compression in COMPRESSIONS {
        overlapping(&path, compression);
        let bag = Bag::open(&path).unwrap();
        // Room for 1 message, for a few, and for all.
        for max in [1, 5 * LEN as u64, PENDING_MAX_BYTES] {
            let filter = Filter::default();
            let mut messages = bag.messages(&filter);
            messages.pending_max_bytes = max;
            let mut most = 0;
            for time in 0..CHUNKS * MESSAGES {
                let message = messages.find().unwrap().unwrap().read().unwrap();
                assert_eq!(message.log_time, time, "{compression:?}, {max} bytes");
                assert!(message.data == payload(time));
                most = most.max(messages.pending_bytes);
            }
            assert!(messages.find().unwrap().is_none());
            assert_eq!(messages.pending_bytes, 0);
            assert!(most <= max || max == 1, "{most} of {max} bytes");
        }
    }
}

#[test]
fn a_filter_holds_for_chunks_that_are_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag");
    overlapping(&path, COMPRESSIONS[2]);
    let bag = Bag::open(&path).unwrap();
    let filter = Filter {
        from_ns: Some(11),
        to_ns: Some(100),
        ..Filter::default()
    };
    let mut messages = bag.messages(&filter);
    messages.pending_max_bytes = 3 * LEN as u64;
    let times = messages.map(|it| it.unwrap().log_time);
    assert!(times.eq(11..100));
}

/// A chunk that is damaged when it is read again costs the rest of its messages, and no other one.
#[test]
fn damage_that_comes_later_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag");
    overlapping(&path, None);
    let bag = Bag::open(&path).unwrap();
    let filter = Filter::default();
    let mut messages = bag.messages(&filter);
    messages.pending_max_bytes = 3 * LEN as u64;
    assert_eq!(messages.next().unwrap().unwrap().log_time, 0);
    let chunk = bag.summary().chunk_indexes[3].clone();
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    let last = chunk.chunk_start_offset + chunk.chunk_length - 1;
    std::os::unix::fs::FileExt::write_all_at(&file, &[7], last).unwrap();
    let (mut times, mut damaged) = (Vec::new(), 0);
    for message in messages {
        match message {
            Ok(it) => times.push(it.log_time),
            Err(ReadError::Damaged { part, .. }) => {
                assert_eq!(part.offset, chunk.chunk_start_offset);
                damaged += 1;
            }
            Err(error) => panic!("{error}"),
        }
    }
    assert_eq!(damaged, 1);
    assert!(times.is_sorted());
    let others = times.iter().filter(|it| **it % CHUNKS != 3).count() as u64;
    assert_eq!(others, (CHUNKS - 1) * MESSAGES - 1);
}
