//! Damage in one place loses what is in that place, and nothing else.

use std::fs::{self, File};
use std::ops::Range;
use std::path::Path;

use mcap::records::{Record, op};
use sm2_bag::{
    Bag, Compression, Damage, DamagedPart, Filter, GapReason, ReadError, Report, check, copy, diff,
    recover,
};
use sm2_test_support::below;

use crate::common::{chunked, memory_folder, picture, places};

/// How many messages the bags have.
const MESSAGES: u64 = 6;
/// One byte of so many is changed: an odd number, so that each bit has its turn.
const BYTE_STEP: usize = if cfg!(feature = "slow") { 1 } else { 7 };
const COMPRESSIONS: [Compression; 3] = [Compression::None, Compression::Lz4, Compression::Zstd];

/// The numbers of a bag that can be read, and the damaged parts.
fn read(bag: &Bag) -> (Vec<u64>, Vec<DamagedPart>) {
    let (mut numbers, mut parts) = (Vec::new(), Vec::new());
    for message in bag.messages(&Filter::default()) {
        match message {
            Ok(it) => numbers.push(u64::from_le_bytes(it.data.try_into().unwrap())),
            Err(ReadError::Damaged { part, .. }) => parts.push(part),
            Err(error) => panic!("{error}"),
        }
    }
    (numbers, parts)
}

fn numbers(path: &Path) -> Vec<u64> {
    read(&Bag::open(path).unwrap()).0
}

/// The numbers without those of this range.
fn without(missing: Range<u64>) -> Vec<u64> {
    (0..MESSAGES).filter(|it| !missing.contains(it)).collect()
}

/// Recovers a bag, and copies it: both have these numbers and no damage of their own. Returns the summaries.
fn rescued(path: &Path, expected: &[u64]) -> [Report; 2] {
    let folder = memory_folder();
    let (recovered, copied) = (
        folder.path().join("recovered"),
        folder.path().join("copied"),
    );
    let bag = Bag::open(path).unwrap();
    let reports = [
        recover(path, &recovered).unwrap(),
        copy(&[bag], &copied, &Filter::default(), Compression::None).unwrap(),
    ];
    for new in [recovered, copied] {
        assert_eq!(numbers(&new), expected, "{reports:?}");
        assert_eq!(check(&new).unwrap().damages, []);
    }
    reports
}

#[test]
fn a_damaged_chunk_is_a_gap() {
    for compression in COMPRESSIONS {
        let bytes = chunked(compression, MESSAGES);
        let folder = memory_folder();
        let (whole, path) = (folder.path().join("whole"), folder.path().join("damaged"));
        fs::write(&whole, &bytes).unwrap();
        let chunks = places(&bytes, op::CHUNK);
        // The first chunk describes the channel.
        for number in [0, 2, MESSAGES - 1] {
            let chunk = chunks[number as usize].clone();
            let mut damaged = bytes.clone();
            // Not in the last bytes: a compression may ignore them.
            damaged[chunk.end - 12] ^= 1;
            fs::write(&path, &damaged).unwrap();
            let (offset, len) = (chunk.start as u64, chunk.len() as u64);
            let is_chunk = |part: &DamagedPart| (part.offset, part.bytes) == (offset, len);

            let (found, parts) = read(&Bag::open(&path).unwrap());
            assert_eq!(found, without(number..number + 1));
            assert!(parts.len() == 1 && is_chunk(&parts[0]), "{parts:?}");
            let damages = check(&path).unwrap().damages;
            assert!(
                matches!(&damages[..], [Damage::Unreadable(part)] if is_chunk(part)),
                "{damages:?}"
            );
            for report in rescued(&path, &found) {
                assert!(report.complete);
                assert_eq!(report.damaged, parts);
                let [topic] = &report.topics[..] else {
                    panic!("{:?}", report.topics);
                };
                assert_eq!((topic.messages, topic.lost), (MESSAGES - 1, 1));
                let [gap] = &topic.gaps[..] else {
                    panic!("{:?}", topic.gaps);
                };
                assert_eq!(
                    (gap.publisher.as_str(), gap.reason),
                    ("talker", GapReason::Damaged)
                );
            }
            let [whole, damaged] = [&whole, &path].map(|it| Bag::open(it).unwrap());
            let compared = diff([&whole, &damaged]).unwrap();
            assert_eq!(compared.damaged, [vec![], parts]);
            assert!(compared.difference.is_some());
        }
    }
}

/// The records behind a damaged head are found, with the summary and without it.
#[test]
fn everything_behind_a_damaged_head_is_kept() {
    for compression in COMPRESSIONS {
        let bytes = chunked(compression, MESSAGES);
        let data_end = places(&bytes, op::DATA_END)[0].start;
        let folder = memory_folder();
        let path = folder.path().join("damaged");
        let chunk = places(&bytes, op::CHUNK)[2].clone();
        // The opcode, the lowest and the highest byte of the length, and the lengths inside.
        for at in [0, 1, 8, 9 + 16, 9 + 28, 9 + 32].map(|it| chunk.start + it) {
            for bit in 0..8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << bit;
                for has_summary in [true, false] {
                    let len = if has_summary { bytes.len() } else { data_end };
                    fs::write(&path, &damaged[..len]).unwrap();
                    let damages = check(&path).unwrap().damages;
                    let is_unreadable = |it: &Damage| matches!(it, Damage::Unreadable(_));
                    let expected = match damages.iter().any(is_unreadable) {
                        true => without(2..3),
                        // The length of the content is a hint for some compressions.
                        false => without(0..0),
                    };
                    let case = format!("byte {at}, bit {bit}, {has_summary}: {damages:?}");
                    assert_eq!(numbers(&path), expected, "{case}");
                    let reports = rescued(&path, &expected);
                    let parts = reports.map(|it| it.damaged.len());
                    let is_damaged = usize::from(expected.len() < MESSAGES as usize);
                    assert_eq!(parts, [is_damaged; 2], "{case}");
                }
            }
        }
    }
}

/// A chunk says its length twice, so a wrong one hides no other chunk even if it ends at a record.
#[test]
fn a_length_that_ends_at_a_later_record_hides_no_chunk() {
    for compression in COMPRESSIONS {
        let mut bytes = chunked(compression, MESSAGES);
        let data_end = places(&bytes, op::DATA_END)[0].start;
        let (chunks, indexes) = (places(&bytes, op::CHUNK), places(&bytes, op::MESSAGE_INDEX));
        let len = indexes[3].start - chunks[2].start - 9;
        bytes[chunks[2].start + 1..][..8].copy_from_slice(&(len as u64).to_le_bytes());
        let folder = memory_folder();
        let path = folder.path().join("damaged");
        for len in [bytes.len(), data_end] {
            fs::write(&path, &bytes[..len]).unwrap();
            assert_eq!(numbers(&path), without(2..3));
            rescued(&path, &without(2..3));
        }
    }
}

/// Nothing else says how long the header and an index are.
#[test]
fn a_header_or_an_index_that_ends_at_a_later_record_hides_no_chunk() {
    for compression in COMPRESSIONS {
        let bytes = chunked(compression, MESSAGES);
        let data_end = places(&bytes, op::DATA_END)[0].start;
        let (chunks, indexes) = (places(&bytes, op::CHUNK), places(&bytes, op::MESSAGE_INDEX));
        let header = places(&bytes, op::HEADER)[0].clone();
        let folder = memory_folder();
        let path = folder.path().join("damaged");
        for (record, end) in [(&header, &chunks[4]), (&indexes[1], &indexes[3])] {
            let mut damaged = bytes.clone();
            let len = end.start - record.start - 9;
            damaged[record.start + 1..][..8].copy_from_slice(&(len as u64).to_le_bytes());
            for len in [bytes.len(), data_end] {
                fs::write(&path, &damaged[..len]).unwrap();
                assert_ne!(check(&path).unwrap().damages, []);
                assert_eq!(numbers(&path), without(0..0));
                rescued(&path, &without(0..0));
            }
        }
    }
}

/// One bit of each byte. Nothing is read that was not recorded, and nothing is missing in silence.
#[test]
fn a_changed_bit_is_noticed_or_changes_no_message() {
    let all = without(0..0);
    for compression in COMPRESSIONS {
        let bytes = chunked(compression, MESSAGES);
        let folder = memory_folder();
        let path = folder.path().join("damaged");
        let summary = places(&bytes, op::DATA_END)[0].end..bytes.len();
        for at in (8 + below(BYTE_STEP)..bytes.len()).step_by(BYTE_STEP) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (at % 8);
            fs::write(&path, &damaged).unwrap();
            let verdict = check(&path).unwrap();
            assert!(
                !summary.contains(&at) || !verdict.damages.is_empty(),
                "byte {at} of the summary, {summary:?}"
            );
            let found = numbers(&path);
            assert!(
                found.is_sorted() && found.iter().all(|it| all.contains(it)),
                "{found:?}"
            );
            assert!(
                found == all || !verdict.damages.is_empty(),
                "byte {at}: {found:?}"
            );
            for report in rescued(&path, &found) {
                let topics = report.topics.iter();
                let lost: u64 = topics.map(|it| it.lost).sum();
                let is_said = lost > 0 || !report.damaged.is_empty();
                assert!(found == all || is_said, "byte {at}: {report:?}");
            }
        }
    }
}

/// A bag of another program, with a message and an attachment.
fn bag_with_attachment(path: &Path) -> Vec<u8> {
    let mut writer = mcap::Writer::new(File::create(path).unwrap()).unwrap();
    let channel_id = writer
        .add_channel(0, "numbers", "", &Default::default())
        .unwrap();
    for number in 0..MESSAGES {
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: 0,
            log_time: number,
            publish_time: 0,
        };
        writer
            .write_to_known_channel(&header, &number.to_le_bytes())
            .unwrap();
    }
    writer.attach(&picture()).unwrap();
    writer.finish().unwrap();
    drop(writer);
    fs::read(path).unwrap()
}

/// The bodies of the attachments.
fn attachments(path: &Path) -> Vec<Vec<u8>> {
    let bytes = fs::read(path).unwrap();
    let places = places(&bytes, op::ATTACHMENT);
    let bodies = places
        .into_iter()
        .map(|it| bytes[it.start + 9..it.end].to_vec());
    bodies.collect()
}

#[test]
fn attachments_are_copied_unless_they_are_damaged() {
    let folder = memory_folder();
    let [from, recovered, copied] =
        ["from", "recovered", "copied"].map(|it| folder.path().join(it));
    let bytes = bag_with_attachment(&from);
    let place = places(&bytes, op::ATTACHMENT)[0].clone();
    let body = bytes[place.start + 9..place.end].to_vec();
    assert!(matches!(
        mcap::parse_record(op::ATTACHMENT, &body),
        Ok(Record::Attachment { .. })
    ));
    for is_damaged in [false, true] {
        let mut bytes = bytes.clone();
        bytes[place.end - 6] ^= u8::from(is_damaged);
        fs::write(&from, &bytes).unwrap();
        for new in [&recovered, &copied] {
            let _ = fs::remove_file(new);
        }
        let bag = Bag::open(&from).unwrap();
        let reports = [
            recover(&from, &recovered).unwrap(),
            copy(&[bag], &copied, &Filter::default(), Compression::None).unwrap(),
        ];
        let expected = if is_damaged {
            vec![]
        } else {
            vec![body.clone()]
        };
        for (path, report) in [&recovered, &copied].into_iter().zip(reports) {
            assert_eq!(attachments(path), expected);
            assert_eq!(report.damaged.len(), usize::from(is_damaged), "{report:?}");
            assert_eq!(numbers(path), without(0..0));
        }
    }
}

/// A recorder that is killed at once leaves an empty file, or a part of the first bytes. It is a bag without messages,
/// which keeps nobody from reading the others.
#[test]
fn a_file_that_was_just_begun_is_an_incomplete_bag() {
    let folder = memory_folder();
    let [begun, whole, copied] = ["begun", "whole", "copied"].map(|it| folder.path().join(it));
    fs::write(&whole, chunked(Compression::None, MESSAGES)).unwrap();
    for len in 0..mcap::MAGIC.len() {
        fs::write(&begun, &mcap::MAGIC[..len]).unwrap();
        let bag = Bag::open(&begun).unwrap();
        assert!(
            !bag.report().complete && bag.report().topics.is_empty(),
            "{len}"
        );
        let damages = check(&begun).unwrap().damages;
        assert!(damages.contains(&Damage::Incomplete), "{len}: {damages:?}");
        let bags = [bag, Bag::open(&whole).unwrap()];
        let report = copy(&bags, &copied, &Filter::default(), Compression::None).unwrap();
        assert_eq!(report.topics[0].messages, MESSAGES, "{len}");
        fs::remove_file(&copied).unwrap();
    }
}
