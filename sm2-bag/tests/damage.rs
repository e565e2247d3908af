//! Bags that were torn or overwritten.

use std::fs;
use std::path::Path;

use sm2_bag::{Bag, Compression, CopyError, Damage, Filter, ReadError, check, recover};
use sm2_test_support::{below, seed};

use crate::common::{chunked, memory_folder};

/// How many messages the torn bags have.
const MESSAGES: u64 = 40;
/// How many messages the bags have whose bytes are changed, one at a time.
const FEW: u64 = 5;

/// How many tears are tried for each compression.
const TEARS: usize = if cfg!(feature = "slow") { 500 } else { 25 };
/// A longer prefix has so many more bytes.
const PREFIX_STEP: usize = if cfg!(feature = "slow") { 19 } else { 95 };
/// One byte of so many is changed: an odd number, so that each bit has its turn.
const BYTE_STEP: usize = if cfg!(feature = "slow") { 1 } else { 19 };

/// The numbers in a bag.
fn numbers(path: &Path) -> Result<Vec<u64>, ReadError> {
    let bag = Bag::open(path)?;
    let messages = bag.messages(&Filter::default());
    let numbers = messages.map(|it| Ok(u64::from_le_bytes(it?.data.try_into().unwrap())));
    let numbers: Result<Vec<_>, ReadError> = numbers.collect();
    let numbers = numbers?;
    let said: u64 = bag.report().topics.iter().map(|it| it.messages).sum();
    assert_eq!(numbers.len() as u64, said);
    Ok(numbers)
}

/// The numbers in a bag before the first one that cannot be read.
fn readable_numbers(path: &Path) -> Vec<u64> {
    let Ok(bag) = Bag::open(path) else {
        return Vec::new();
    };
    let messages = bag.messages(&Filter::default());
    let data = messages.map_while(Result::ok).map(|it| it.data);
    data.map(|it| u64::from_le_bytes(it.try_into().unwrap()))
        .collect()
}

#[test]
fn a_torn_bag_has_everything_before_the_tear() {
    for compression in [Compression::None, Compression::Zstd] {
        let bytes = chunked(compression, MESSAGES);
        let folder = memory_folder();
        let (torn, whole) = (folder.path().join("torn"), folder.path().join("whole"));
        let mut longest = 0;
        let mut state = seed();
        let random = std::iter::repeat_with(|| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as usize % bytes.len()
        });
        // Nearly everything is left by the first tear.
        for len in [bytes.len() - 1].into_iter().chain(random.take(TEARS)) {
            fs::write(&torn, &bytes[..len]).unwrap();
            let read = match numbers(&torn) {
                Ok(read) => read,
                Err(error) => {
                    assert!(
                        len < 8 && matches!(error, ReadError::NotABag { .. }),
                        "{len}: {error}"
                    );
                    continue;
                }
            };
            let count = read.len() as u64;
            assert!(read.iter().copied().eq(0..count), "{len}: {read:?}");
            longest = longest.max(count);
            let verdict = check(&torn).unwrap();
            assert!(
                verdict.damages.contains(&Damage::Incomplete),
                "{len}: {:?}",
                verdict.damages
            );
            let _ = fs::remove_file(&whole);
            let recovered = recover(&torn, &whole).unwrap();
            assert!(recovered.complete);
            assert_eq!(numbers(&whole).unwrap(), read, "{len}");
            assert_eq!(check(&whole).unwrap().damages, [], "{len}");
        }
        assert!(longest > MESSAGES / 2, "{longest}");
    }
}

#[test]
fn a_longer_prefix_never_has_fewer_messages() {
    let bytes = chunked(Compression::None, MESSAGES);
    let folder = memory_folder();
    let torn = folder.path().join("torn");
    let mut before = 0;
    for len in (below(PREFIX_STEP)..bytes.len()).step_by(PREFIX_STEP) {
        fs::write(&torn, &bytes[..len]).unwrap();
        let count = numbers(&torn).unwrap().len();
        assert!(count >= before, "{len}: {count} < {before}");
        before = count;
    }
    assert!(before > MESSAGES as usize / 2);
}

#[test]
fn nothing_else_is_a_bag() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    for content in [&b"\x89MCAQ"[..], b"ustar and so on"] {
        fs::write(&path, content).unwrap();
        assert!(matches!(Bag::open(&path), Err(ReadError::NotABag { .. })));
    }
    let absent = folder.path().join("absent");
    assert!(matches!(check(&absent), Err(ReadError::Io { .. })));
    fs::write(&path, b"\x89MCAP0\r\n").unwrap();
    let taken = recover(&path, &path);
    assert!(matches!(taken, Err(CopyError::Write { .. })), "{taken:?}");
    assert_eq!(fs::read(&path).unwrap(), b"\x89MCAP0\r\n");
}

#[test]
fn a_bag_with_a_changed_byte_has_no_other_messages() {
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let bytes = chunked(compression, FEW);
        let folder = memory_folder();
        let path = folder.path().join("damaged");
        let (mut changed, mut noticed) = (0, 0);
        for at in (below(BYTE_STEP)..bytes.len()).step_by(BYTE_STEP) {
            let mut damaged = bytes.clone();
            // One bit, another one at each place.
            damaged[at] ^= 1 << (at % 8);
            fs::write(&path, &damaged).unwrap();
            changed += 1;
            // Also where `check` finds the damage.
            let read = readable_numbers(&path);
            assert!(
                read.is_sorted_by(|a, b| a < b) && read.iter().all(|it| *it < FEW),
                "{compression:?}, byte {at}: {read:?}"
            );
            if check(&path).is_ok_and(|it| it.damages.is_empty()) {
                let read = numbers(&path).unwrap();
                assert!(
                    read.iter().copied().eq(0..FEW),
                    "{compression:?}, byte {at}: {read:?}"
                );
            } else {
                noticed += 1;
            }
        }
        assert!(2 * noticed > changed, "{noticed} of {changed} noticed");
    }
}

/// A record of an MCAP file.
fn record_of(opcode: u8, body: &[u8]) -> Vec<u8> {
    let len = u64::try_from(body.len()).unwrap().to_le_bytes();
    [&[opcode][..], &len, body].concat()
}

/// A file with these records, and a summary of those behind them.
fn file_of(records: &[u8], summary: &[u8]) -> Vec<u8> {
    const MAGIC: &[u8] = b"\x89MCAP0\r\n";
    let start = (MAGIC.len() + records.len()) as u64;
    let footer = [&start.to_le_bytes()[..], &[0; 12]].concat();
    [MAGIC, records, summary, &record_of(2, &footer), MAGIC].concat()
}

/// The parser of the crate `mcap` panics on an attachment without room for its checksum.
#[test]
fn a_short_attachment_in_the_summary_is_ignored() {
    let folder = memory_folder();
    let path = folder.path().join("attachment");
    let file = file_of(&record_of(1, &[0; 8]), &record_of(9, &[0; 32]));
    fs::write(&path, file).unwrap();
    assert_eq!(Bag::open(&path).unwrap().report().topics, []);
}

/// A summary with several entries for one chunk would multiply the memory of its messages.
#[test]
fn chunks_that_overlap_are_read_once() {
    let bytes = chunked(Compression::None, FEW);
    let folder = memory_folder();
    let path = folder.path().join("overlap");
    let index_opcode = 8;
    // The summary is behind the last chunk. Its first entry of a chunk is put there once more.
    let footer = bytes.len() - 8 - 29;
    let start = u64::from_le_bytes(bytes[footer + 9..][..8].try_into().unwrap());
    let start = usize::try_from(start).unwrap();
    let mut at = start;
    while bytes[at] != index_opcode {
        let len = u64::from_le_bytes(bytes[at + 1..][..8].try_into().unwrap());
        at += 9 + usize::try_from(len).unwrap();
    }
    let len = u64::from_le_bytes(bytes[at + 1..][..8].try_into().unwrap());
    let entry = bytes[at..][..9 + usize::try_from(len).unwrap()].to_vec();
    let mut twice = bytes.clone();
    twice.splice(at..at, entry);
    fs::write(&path, twice).unwrap();
    assert!(numbers(&path).unwrap().into_iter().eq(0..FEW));
}

/// Python's writer names a channel without messages in the summary only.
#[test]
fn a_channel_without_messages_may_be_in_the_summary_alone() {
    let folder = memory_folder();
    let path = folder.path().join("empty");
    let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
    let channel = [&[1, 0, 0, 0][..], &text("/scan"), &text("cdr"), &[0; 4]].concat();
    // One channel, and nothing else.
    let mut statistics = [0; 46];
    statistics[10] = 1;
    let summary = [record_of(4, &channel), record_of(11, &statistics)].concat();
    let records = [record_of(1, &[0; 8]), record_of(15, &[0; 4])].concat();
    fs::write(&path, file_of(&records, &summary)).unwrap();
    let verdict = check(&path).unwrap();
    assert_eq!(verdict.damages, []);
    let topics = &verdict.report.topics;
    assert_eq!((topics[0].name.as_str(), topics[0].messages), ("/scan", 0));
}

/// Other programs write 0 as the times of a chunk.
#[test]
fn a_chunk_with_wrong_times_is_read_by_those_of_its_messages() {
    for compression in [Compression::None, Compression::Zstd] {
        let bytes = chunked(compression, FEW);
        let folder = memory_folder();
        let (path, whole) = (folder.path().join("zero"), folder.path().join("whole"));
        let magic_len = 8;
        let (mut at, mut first) = (magic_len, None);
        let mut zero = bytes.clone();
        while bytes[at] != 15 {
            let len = u64::from_le_bytes(bytes[at + 1..][..8].try_into().unwrap());
            if bytes[at] == 6 {
                zero[at + 9..][..16].fill(0);
                first.get_or_insert(at as u64);
            }
            at += 9 + usize::try_from(len).unwrap();
        }
        // Without a summary, as the records are read then.
        let footer = zero.len() - 8 - 20;
        zero[footer..][..8].fill(0);
        fs::write(&path, &zero).unwrap();
        assert!(numbers(&path).unwrap().into_iter().eq(0..FEW));
        let offset = first.unwrap();
        let verdict = check(&path).unwrap();
        assert!(
            verdict.damages.contains(&Damage::Times { offset }),
            "{verdict:?}"
        );
        recover(&path, &whole).unwrap();
        assert!(numbers(&whole).unwrap().into_iter().eq(0..FEW));
        assert_eq!(check(&whole).unwrap().damages, []);
    }
}
