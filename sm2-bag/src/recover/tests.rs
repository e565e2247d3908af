//! Damage in all places of small bags: nothing is missing in a copy that does not say so.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use sm2_proto::{Instant, Name, TypeId};
use sm2_test_support::memory;

use super::*;
use crate::clock::ClockRelation;
use crate::copy::copy as copy_bags;
use crate::gap::{Gap, GapReason};
use crate::source::{Source, UNKNOWN_OFFER};
use crate::writer::{BagWriter, LongMessage, MessageTimes};
use crate::written_by::WrittenBy;

/// The length of the opcode and the length of a record.
const HEAD: usize = 9;
/// The length of the head of a chunk without compression.
const CHUNK_HEAD: usize = HEAD + 40;
/// One byte of so many is changed in the bodies of records: an odd number, so that each bit has its turn.
const BYTE_STEP: usize = if cfg!(feature = "slow") { 1 } else { 29 };
/// One bit of so many is changed in the heads of records.
const BIT_STEP: usize = if cfg!(feature = "slow") { 1 } else { 53 };
/// One wrong length of so many is tried.
const LENGTH_STEP: usize = if cfg!(feature = "slow") { 1 } else { 3 };
/// One pair of damages of so many is tried.
const PAIR_STEP: usize = 601;
const COMPRESSIONS: [Compression; 2] = [Compression::None, Compression::Zstd];

/// A bag of two topics with several chunks and gaps and a long message.
struct Small {
    folder: tempfile::TempDir,
    bytes: Vec<u8>,
    /// The numbers of the messages of each publisher.
    recorded: BTreeMap<String, Vec<u32>>,
    /// How many messages the gaps of each publisher have.
    lost: BTreeMap<String, u64>,
}

/// A record outside of the chunks.
#[derive(Clone, Debug)]
struct Place {
    opcode: u8,
    at: Range<usize>,
}

fn source(topic: &str, node: &str) -> Arc<Source> {
    let name = |it| Name::new(it).unwrap();
    Arc::new(Source {
        topic: name(topic),
        publisher: name(node),
        data: TypeId {
            name: name("u8"),
            hash: 1,
        },
        offer: UNKNOWN_OFFER,
        schema: None,
    })
}

impl Small {
    fn new(compression: Compression, is_complete: bool) -> Self {
        let folder = tempfile::tempdir_in(memory()).unwrap();
        let path = folder.path().join("bag");
        let clock = ClockRelation {
            monotonic: Instant(5),
            wall_ns: 7,
        };
        let by = WrittenBy {
            node: "recorder".to_owned(),
            process: 7,
            since_ns: 9,
        };
        let file = File::create_new(&path).unwrap();
        let mut bag = BagWriter::new(Box::new(file), compression, clock, &by).unwrap();
        let sources = [source("scan", "lidar"), source("map", "mapper")];
        let mut small = Self {
            folder,
            bytes: Vec::new(),
            recorded: BTreeMap::new(),
            lost: BTreeMap::new(),
        };
        let mut sequence = 0;
        for part in 0..4 {
            for number in 0..5 {
                let source = &sources[number % 2];
                let times = small.next(source, &mut sequence);
                let data = vec![sequence as u8; 8 + number];
                bag.message(source, times, &data).unwrap();
            }
            if part == 1 {
                let times = small.next(&sources[0], &mut sequence);
                // A search for the next record finds what looks like the end of the data.
                let end = [op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];
                let message = LongMessage::Owned([&[1; 50][..], &end, &[1; 50]].concat());
                bag.long_message(&sources[0], times, message, Box::new(|| ()))
                    .unwrap();
            }
            for source in &sources[..=part % 2] {
                let gap = Gap {
                    publisher: source.publisher.to_string(),
                    from_ns: u64::from(sequence) * 10,
                    to_ns: u64::from(sequence) * 10 + 5,
                    messages: 3 + part as u64,
                    reason: GapReason::Displaced,
                };
                *small.lost.entry(gap.publisher.clone()).or_default() += gap.messages;
                bag.gap(source, gap).unwrap();
            }
            bag.begin_sync().unwrap();
            bag.end_sync().unwrap();
        }
        if is_complete {
            bag.finish().unwrap();
        }
        drop(bag);
        small.bytes = fs::read(&path).unwrap();
        small
    }

    /// The next message, of this publisher.
    fn next(&mut self, source: &Source, sequence: &mut u32) -> MessageTimes {
        *sequence += 1;
        let node = source.publisher.to_string();
        self.recorded.entry(node).or_default().push(*sequence);
        MessageTimes {
            sequence: *sequence,
            log_time: u64::from(*sequence) * 10,
            publish_time: 3,
        }
    }

    fn places(&self) -> Vec<Place> {
        let (mut all, mut at) = (Vec::new(), mcap::MAGIC.len());
        let end = self.bytes.len();
        while at + HEAD <= end && self.bytes[at..] != *mcap::MAGIC {
            let to = at + HEAD + self.len_at(at);
            let opcode = self.bytes[at];
            all.push(Place { opcode, at: at..to });
            at = to;
        }
        all
    }

    fn len_at(&self, at: usize) -> usize {
        u64::from_le_bytes(self.bytes[at + 1..][..8].try_into().unwrap()) as usize
    }

    /// The places where records begin, also inside of chunks that are not compressed.
    fn begins(&self) -> Vec<usize> {
        let mut all = Vec::new();
        for Place { opcode, at } in self.places() {
            all.push(at.start);
            let mut inside = at.start + CHUNK_HEAD;
            let is_open =
                opcode == op::CHUNK && self.bytes[at.start + CHUNK_HEAD - 12..][..4] == [0; 4];
            while is_open && inside < at.end {
                all.push(inside);
                inside += HEAD + self.len_at(inside);
            }
        }
        all
    }

    fn with_len(&self, at: usize, to: usize) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        let len = (to - at - HEAD) as u64;
        bytes[at + 1..][..8].copy_from_slice(&len.to_le_bytes());
        bytes
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Recovers and copies damaged bytes, and checks both. `keeps_gaps`: the content of no gap has changed.
    fn check(&self, bytes: &[u8], keeps_gaps: bool, case: &str) {
        let [damaged, recovered, copied] =
            ["damaged", "recovered", "copied"].map(|it| self.path(it));
        fs::write(&damaged, bytes).unwrap();
        let Ok(bag) = Bag::open(&damaged) else {
            return;
        };
        let file = File::open(&damaged).unwrap();
        let described = Bag::of_summary(&damaged, &file, bytes.len() as u64).unwrap();
        for (new, what) in [(&recovered, "recovered"), (&copied, "copied")] {
            let _ = fs::remove_file(new);
            let context = format!("{what}: {case}");
            let report = match what {
                "copied" => copy_bags(
                    std::slice::from_ref(&bag),
                    new,
                    &Filter::default(),
                    Compression::None,
                ),
                _ => recover(&damaged, new),
            };
            let report = report.unwrap_or_else(|error| panic!("{context}: {error}"));
            let missing = self.missing(new, &context);
            let is_said = !report.damaged.is_empty() || !lost(&report, true).is_empty();
            assert!(missing.is_empty() || is_said, "{context}: {report:?}");
            if described.is_some() {
                assert_eq!(lost(&report, true), missing, "{context}");
            }
            let has_gaps = !keeps_gaps || !bag.is_complete() || lost(&report, false) == self.lost;
            assert!(has_gaps || is_said, "{context}: {report:?}");
        }
    }

    /// How many messages of each publisher a bag lacks. It has no others.
    fn missing(&self, path: &Path, context: &str) -> BTreeMap<String, u64> {
        let mut left = self.recorded.clone();
        for message in Bag::open(path).unwrap().messages(&Filter::default()) {
            let message = message.unwrap_or_else(|error| panic!("{context}: {error}"));
            let node = Source::of_channel(&message.channel).unwrap().publisher;
            let numbers = left.get_mut(node.as_str()).unwrap();
            let place = numbers.iter().position(|it| *it == message.sequence);
            numbers.remove(place.unwrap_or_else(|| panic!("{context}: {}", message.sequence)));
        }
        let counts = left.into_iter().map(|(node, it)| (node, it.len() as u64));
        counts.filter(|it| it.1 > 0).collect()
    }
}

/// How many messages of each publisher are missing because of damage, or for other reasons.
fn lost(report: &Report, by_damage: bool) -> BTreeMap<String, u64> {
    let mut lost = BTreeMap::new();
    for gap in report.topics.iter().flat_map(|it| &it.gaps) {
        if by_damage == (gap.reason == GapReason::Damaged) {
            *lost.entry(gap.publisher.clone()).or_default() += gap.messages;
        }
    }
    lost
}

/// A record that is too long swallows those before the place where it ends by chance. That can be inside of a chunk.
#[test]
fn a_length_that_ends_at_any_record_hides_nothing() {
    for is_complete in [true, false] {
        let small = Small::new(Compression::None, is_complete);
        let begins = small.begins();
        let ends = |place: &Place| {
            let from = place.at.start + HEAD;
            let all = begins.iter().filter(move |it| **it >= from);
            all.step_by(LENGTH_STEP).copied().collect::<Vec<_>>()
        };
        for place in small.places() {
            for to in ends(&place) {
                let bytes = small.with_len(place.at.start, to);
                let keeps_gaps = place.opcode != op::METADATA;
                small.check(&bytes, keeps_gaps, &format!("{place:?} to {to}"));
            }
        }
    }
}

#[test]
fn a_changed_bit_hides_no_message() {
    for compression in COMPRESSIONS {
        for is_complete in [true, false] {
            let small = Small::new(compression, is_complete);
            for Place { opcode, at } in small.places() {
                let (head, body) = (at.start..at.start + HEAD, at.start + HEAD..at.end);
                let heads = head.flat_map(|at| (0..8).map(move |bit| (at, bit)));
                let heads = heads.step_by(BIT_STEP);
                let bodies = body.step_by(BYTE_STEP).map(|at| (at, at % 8));
                // A padding has no meaning.
                let bodies = bodies.filter(|_| opcode < 0x80);
                for (at, bit) in heads.chain(bodies) {
                    let mut bytes = small.bytes.clone();
                    bytes[at] ^= 1 << bit;
                    let case = format!("{compression:?}, bit {bit} of byte {at} (record {opcode})");
                    small.check(&bytes, opcode != op::METADATA, &case);
                }
            }
        }
    }
}

/// Damages of a record: its opcode, its length, some of its bytes, or all of them.
fn damages(place: &Place) -> impl Iterator<Item = (&'static str, Range<usize>, u8)> + use<> {
    let Range { start, end } = place.at.clone();
    let middle = (start + end) / 2;
    [
        ("private", start..start + 1, 0x80),
        ("index", start..start + 1, 1),
        ("longer", start + 1..start + 2, 4),
        ("shorter", start + 2..start + 3, 0xff),
        ("burst", start..(start + 40).min(end), 0x5a),
        ("content", middle..(middle + 9).min(end), 0x24),
        ("all", start..end, 0xc3),
    ]
    .into_iter()
}

/// The summary and the footer are such places as well. Not covered: behind a damaged end of the data, a record of the
/// summary whose opcode became that of a message is believed.
#[test]
fn two_damaged_places_hide_no_message() {
    let mut number = 0_usize;
    for is_complete in [true, false] {
        let small = Small::new(Compression::None, is_complete);
        let places = small.places();
        let pairs = places.iter().enumerate();
        let pairs = pairs.flat_map(|(at, one)| places[at + 1..].iter().map(move |it| (one, it)));
        for (one, other) in pairs.filter(|(one, _)| one.opcode != op::DATA_END) {
            for (what, first, bits) in damages(one) {
                for (how, second, others) in damages(other) {
                    number += 1;
                    if !number.is_multiple_of(PAIR_STEP) {
                        continue;
                    }
                    let mut bytes = small.bytes.clone();
                    bytes[first.clone()].iter_mut().for_each(|it| *it ^= bits);
                    bytes[second].iter_mut().for_each(|it| *it ^= others);
                    let is_gap = [one, other].iter().any(|it| it.opcode == op::METADATA);
                    let case = format!("{what} of {one:?}, {how} of {other:?}");
                    small.check(&bytes, !is_gap, &case);
                }
            }
        }
    }
}

/// A recorder that is killed leaves a part of a record. A record that is there as a whole is damaged.
#[test]
fn the_last_chunk_of_a_file_without_an_end_is_named_if_it_is_damaged() {
    for compression in COMPRESSIONS {
        let small = Small::new(compression, false);
        let places = small.places();
        let last = places.iter().rfind(|it| it.opcode == op::CHUNK).unwrap();
        for (what, at, bits) in damages(last) {
            let mut bytes = small.bytes[..last.at.end].to_vec();
            bytes[at].iter_mut().for_each(|it| *it ^= bits);
            small.check(&bytes, true, what);
        }
        let [torn, new] = ["torn", "new"].map(|it| small.path(it));
        for len in last.at.start + 1..last.at.end {
            fs::write(&torn, &small.bytes[..len]).unwrap();
            assert_eq!(Bag::open(&torn).unwrap().report().damaged, [], "{len}");
            let report = recover(&torn, &new).unwrap();
            assert_eq!(report.damaged, [], "{len}");
            fs::remove_file(&new).unwrap();
        }
    }
}
