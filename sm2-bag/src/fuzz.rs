//! The body of the fuzz target in `fuzz/` that reads bags.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Cursor;
use std::os::fd::AsRawFd;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;

use mcap::records::{MessageHeader, Metadata};
use mcap::{MAGIC, McapResult, Writer};
use nix::sys::memfd::{MFdFlags, memfd_create};
use sm2_proto::fuzz::Script;

use crate::bag::{Bag, scan_file};
use crate::clock::ClockRelation;
use crate::error::{ReadError, WriteError};
use crate::gap::{Gap, GapReason};
use crate::messages::{BagMessage, Filter};
use crate::observer::unobserved;
use crate::profile::Profile;
use crate::report::{Counts, Report};
use crate::verify::check;
use crate::writer::{Compression, write_counts, write_options};
use crate::{recover, source::Source};

/// Fuzzes bags. If the first byte is 0, the rest are the records of a file. Otherwise it chooses the options of a small
/// bag, and the rest is a script: the channels and messages, and then changes of the bytes of the bag.
///
/// A bag without damage has the messages that its summary counts. The readable part of a damaged one is a bag without
/// damage.
pub fn bag_file(data: &[u8]) {
    let Some((&options, rest)) = data.split_first() else {
        return;
    };
    let mut script = Script::new(rest);
    let bytes = match options {
        0 => [MAGIC, rest].concat(),
        _ => match small_bag(options, &mut script) {
            Ok(mut bytes) => {
                while change(&mut bytes, &mut script).is_some() {}
                bytes
            }
            Err(error) => panic!("a small bag can be written: {error}"),
        },
    };
    read(&memfd(&bytes));
}

/// Definitions of ROS 2; some do not parse.
const DEFINITIONS: [&str; 4] = [
    "string data\n",
    "Part part\n",
    "T t\n",
    "float64[4294967295] a",
];
const TOPICS: [&str; 4] = ["a", "/a", "b/c", "//"];
const MESSAGES_MAX: u8 = 12;

/// Writes a bag that the script describes, as far as it goes.
fn small_bag(options: u8, script: &mut Script<'_>) -> McapResult<Vec<u8>> {
    let compression = [Compression::None, Compression::Lz4, Compression::Zstd];
    let written = write_options(compression[usize::from(options % 3)], Profile::Sm2)
        .chunk_size(Some(100))
        // Without checksums, changes of a chunk reach the code that reads its records.
        .calculate_chunk_crcs(options & 4 != 0)
        .use_chunks(options & 0x60 != 0);
    let mut writer = written.create(Cursor::new(Vec::new()))?;
    let clock = ClockRelation {
        monotonic: sm2_proto::Instant(5),
        wall_ns: 7,
    };
    metadata(&mut writer, ClockRelation::RECORD, clock.metadata())?;
    let mut channels = Vec::new();
    for _ in 0..=script.below(3).unwrap_or(0) {
        channels.push(channel(&mut writer, script)?);
    }
    let mut counts = BTreeMap::<u16, Counts>::new();
    for sequence in 0..script.below(MESSAGES_MAX).unwrap_or(0) {
        let channel_id = channels[script.below(3).unwrap_or(0) % channels.len()];
        let (log_time, data) = (script.number(), script.bytes());
        let (log_time, data) = (log_time.unwrap_or(1), data.unwrap_or_default());
        let header = MessageHeader {
            channel_id,
            sequence: sequence as u32,
            log_time,
            publish_time: 3,
        };
        writer.write_to_known_channel(&header, data)?;
        counts.entry(channel_id).or_default().add(data.len());
    }
    for _ in 0..script.below(3).unwrap_or(0) {
        let gap = Gap {
            publisher: "talker".to_owned(),
            from_ns: script.number().unwrap_or(1),
            to_ns: script.number().unwrap_or(2),
            messages: script.number().unwrap_or(3),
            reason: GapReason::Budget,
        };
        metadata(&mut writer, Gap::RECORD, gap.metadata("a"))?;
    }
    if options & 8 == 0 {
        write_counts(&mut writer, &counts)?;
    }
    if options & 16 == 0 {
        writer.finish()?;
    } else {
        writer.flush()?;
    }
    Ok(writer.into_inner().into_inner())
}

type Memory = Cursor<Vec<u8>>;

fn metadata(
    writer: &mut Writer<Memory>,
    name: &str,
    metadata: BTreeMap<String, String>,
) -> McapResult<()> {
    let name = name.to_owned();
    writer.write_metadata(&Metadata { name, metadata })
}

/// Adds a channel of SM2, or one that another program could have recorded.
fn channel(writer: &mut Writer<Memory>, script: &mut Script<'_>) -> McapResult<u16> {
    let topic = TOPICS[script.below(4).unwrap_or(0)];
    let definition = DEFINITIONS[script.below(4).unwrap_or(0)].as_bytes();
    let schema = match script.below(3) {
        Some(0) => writer.add_schema("p/msg/T", "ros2msg", definition)?,
        Some(1) => writer.add_schema("text", "sm2", b"plain:string")?,
        _ => 0,
    };
    let keys = ["topic_type_hash", "offered_qos_profiles", "sm2.type"];
    let mut metadata = BTreeMap::new();
    if let Some(at) = script.below(4).filter(|at| *at < keys.len()) {
        let value = String::from_utf8_lossy(script.bytes().unwrap_or_default());
        metadata.insert(keys[at].to_owned(), value.into_owned());
    }
    let encoding = ["cdr", "plain"][script.below(2).unwrap_or(0)];
    writer.add_channel(schema, topic, encoding, &metadata)
}

/// Changes the bytes of a file. `None` if the script is over.
fn change(bytes: &mut Vec<u8>, script: &mut Script<'_>) -> Option<()> {
    let (kind, high, low) = (script.below(8)?, script.byte()?, script.byte()?);
    let at = usize::from(u16::from_be_bytes([high, low])) % (bytes.len() + 1);
    let until = |len: usize| (at + len).min(bytes.len());
    match kind {
        0 => bytes.truncate(at),
        1 => drop(bytes.drain(at..until(9))),
        // A number, such as a length or an offset.
        2 => {
            let number = script.number()?.to_le_bytes();
            let end = until(8);
            bytes.splice(at..end, number);
        }
        3 => {
            let end = until(script.byte()?.into());
            bytes.extend_from_within(at..end);
        }
        4 => {
            let inserted = script.bytes()?;
            bytes.splice(at..at, inserted.iter().copied());
        }
        _ => {
            let value = script.byte()?;
            *bytes.get_mut(at)? = value;
        }
    }
    Some(())
}

/// Reads a file in every way.
fn read(file: &File) {
    let path = path(file);
    let bag = match Bag::open(&path) {
        Ok(bag) => bag,
        Err(ReadError::NotABag { .. }) => return,
        Err(error) => panic!("memory can be read: {error}"),
    };
    let report = bag.report();
    let found = messages(&bag);
    let verdict = check(&path).expect("memory can be read");
    assert_eq!(verdict.report, report);
    if verdict.damages.is_empty() {
        let found = found.as_ref().expect("no damage, so all are there");
        assert_eq!(found.len() as u64, count(&report));
    }
    for (channel, source) in bag.sources() {
        match source {
            Ok(source) => is_written_again(&source),
            Err(error) => assert!(!error.to_string().is_empty(), "{}", channel.topic),
        }
    }
    let end = file.metadata().expect("memory can be read").len();
    let scan = scan_file(&path, file, end, &mut unobserved).expect("nobody stops it");
    let summary = Bag::of_summary(&path, file, end).expect("memory can be read");
    let copied = memfd(&[]);
    match recover::copy(file, &scan, summary.as_ref(), &copied, &mut |_| true) {
        Ok(()) => is_whole(&bag, &copied),
        // Such as two channels with one number.
        Err(error) => assert!(matches!(error, WriteError::Format(_)), "{error}"),
    }
}

/// A channel of this publisher in a new bag is the same publisher.
fn is_written_again(source: &Source) {
    assert_eq!(Source::of_channel(&source.channel()).as_ref(), Some(source));
}

/// A recovered bag has no damage, and the messages of the readable part.
fn is_whole(bag: &Bag, recovered: &File) {
    let path = path(recovered);
    assert_eq!(check(&path).expect("a bag").damages, []);
    let recovered = Bag::open(&path).expect("a bag");
    let found = messages(&recovered).expect("no damage");
    assert_eq!(found.len() as u64, count(&recovered.report()));
    // A bag with a summary can have less than its summary says.
    if !bag.is_complete()
        && let Ok(before) = messages(bag)
    {
        let payloads = |messages: &[BagMessage]| -> Vec<_> {
            let payloads = messages.iter().map(|it| (it.log_time, it.data.clone()));
            payloads.collect()
        };
        assert_eq!(payloads(&found), payloads(&before));
    }
}

fn messages(bag: &Bag) -> Result<Vec<BagMessage>, ReadError> {
    bag.messages(&Filter::default()).collect()
}

fn count(report: &Report) -> u64 {
    report.topics.iter().map(|it| it.messages).sum()
}

/// A file in memory.
fn memfd(bytes: &[u8]) -> File {
    let fd = memfd_create(c"bag", MFdFlags::empty()).expect("a descriptor is free");
    let file = File::from(fd);
    file.write_all_at(bytes, 0).expect("memory is free");
    file
}

fn path(file: &File) -> PathBuf {
    format!("/proc/self/fd/{}", file.as_raw_fd()).into()
}
