//! Compares a bag with what was published.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use super::random::Random;
use super::talkers::{Account, Talkers, payload};
use crate::bag::Bag;
use crate::error::ReadError;
use crate::messages::Filter;
use crate::recover::recover;
use crate::report::Report;
use crate::source::Source;

/// The messages of a publisher in a bag.
#[derive(Debug, Default, PartialEq, Eq)]
struct Found {
    /// The numbers of its messages.
    numbers: Vec<usize>,
    /// How many are missing.
    lost: u64,
}

/// The content of a bag, by the node of the publisher, and how many of its parts could not be read.
fn found(bag: &Bag, talkers: &Talkers) -> (BTreeMap<String, Found>, usize) {
    let mut found = BTreeMap::<String, Found>::new();
    let mut damaged = 0;
    for message in bag.messages(&Filter::default()) {
        let message = match message {
            Ok(it) => it,
            Err(ReadError::Damaged { .. }) => {
                damaged += 1;
                continue;
            }
            Err(error) => panic!("{error}"),
        };
        let node = Source::of_channel(&message.channel)
            .unwrap()
            .publisher
            .to_string();
        let number = message.sequence as usize;
        let account = &talkers.accounts()[&node];
        assert_eq!(message.channel.topic, account.topic);
        let len = account.lengths[number - 1];
        assert!(
            message.data == payload(&node, number, len),
            "{node} {number}"
        );
        let numbers = &mut found.entry(node).or_default().numbers;
        assert!(
            numbers.last().is_none_or(|it| *it < number),
            "{number} after {numbers:?}"
        );
        numbers.push(number);
    }
    for topic in bag.report().topics {
        for gap in topic.gaps {
            found.entry(gap.publisher).or_default().lost += gap.messages;
        }
    }
    (found, damaged)
}

/// Checks the bag of a recording that has ended with this summary; `None` after a kill.
pub(super) fn check(path: &Path, report: Option<&Report>, talkers: &Talkers, is_clean: bool) {
    let bag = match Bag::open(path) {
        Ok(bag) => bag,
        // Its first bytes were not written.
        Err(error) => {
            assert!(report.is_none(), "{error}");
            return;
        }
    };
    if let Some(report) = report {
        assert_eq!(bag.report(), *report);
    }
    let (found, damaged) = found(&bag, talkers);
    assert_eq!(damaged, 0);
    let missing = bag.report().missing;
    for (node, account) in talkers.accounts() {
        let nothing = Found::default();
        let found = found.get(node).unwrap_or(&nothing);
        let is_missing = missing.iter().any(|it| it.topic == account.topic);
        let is_whole = report.is_some() && !is_missing;
        let context = || format!("{node}: {found:?} of {account:?} in {:#?}", bag.report());
        assert!(found.sum() <= account.published(), "{}", context());
        if is_whole {
            assert!(
                found.sum() + account.unsaid >= account.promised(),
                "{}",
                context()
            );
        }
        // After a kill, everything up to its last message is there.
        if let (None, true, Some(last), false) =
            (report, is_clean, found.numbers.last(), is_missing)
        {
            let first = account.first.max(1).min(found.numbers[0]);
            assert!(
                found.sum() + account.unsaid >= (last + 1 - first) as u64,
                "{}",
                context()
            );
        }
    }
}

impl Found {
    fn sum(&self) -> u64 {
        self.numbers.len() as u64 + self.lost
    }
}

impl Account {
    fn published(&self) -> u64 {
        self.lengths.len() as u64
    }

    /// How many messages the recorder must have, or name as missing.
    fn promised(&self) -> u64 {
        match self.is_recorded && self.was_linked {
            true => (self.lengths.len() + 1).saturating_sub(self.first.max(1)) as u64,
            false => 0,
        }
    }
}

/// Damages copies of a bag. Nothing is missing in them in silence.
pub(super) fn damage(path: &Path, talkers: &Talkers, random: &mut Random) {
    let bytes = fs::read(path).unwrap();
    let whole = found(&Bag::open(path).unwrap(), talkers).0;
    let [torn, recovered] = ["torn", "recovered"].map(|it| path.with_file_name(it));
    for _ in 0..3 {
        let mut bytes = bytes.clone();
        match random.below(8) {
            0 | 1 => bytes.truncate(random.below(bytes.len() as u64) as usize),
            2 | 3 => lengthen(&mut bytes, random),
            _ => {
                for _ in 0..=random.below(3) {
                    let at = random.below(bytes.len() as u64) as usize;
                    bytes[at] ^= 1 << random.below(8);
                }
            }
        }
        fs::write(&torn, &bytes).unwrap();
        let Ok(bag) = Bag::open(&torn) else {
            // It does not begin like a bag any more.
            continue;
        };
        let (left, damaged) = found(&bag, talkers);
        let report = bag.report();
        let is_said = damaged > 0 || !report.complete || !report.damaged.is_empty();
        assert!(
            is_said || numbers(&left) == numbers(&whole),
            "{left:?} of {whole:?}"
        );
        let known = |(node, number): (&String, &usize)| whole[node].numbers.contains(number);
        let mut all = left
            .iter()
            .flat_map(|(node, it)| it.numbers.iter().map(move |it| (node, it)));
        assert!(all.all(known), "{left:?} of {whole:?}");
        let _ = fs::remove_file(&recovered);
        let report = recover(&torn, &recovered).unwrap();
        let (copied, damaged) = found(&Bag::open(&recovered).unwrap(), talkers);
        assert_eq!(damaged, 0);
        let is_said = !bag.is_complete() || !report.damaged.is_empty();
        assert!(
            is_said || numbers(&copied) == numbers(&whole),
            "{copied:?} of {whole:?}"
        );
        assert_eq!(numbers(&copied), numbers(&left));
    }
}

/// Changes the length of a record, so that it ends where a later one begins.
fn lengthen(bytes: &mut [u8], random: &mut Random) {
    let head = 9;
    let (mut begins, mut at) = (Vec::new(), mcap::MAGIC.len());
    while let Some(len) = bytes.get(at + 1..).and_then(|it| it.first_chunk()) {
        begins.push(at);
        at = at.saturating_add(head + u64::from_le_bytes(*len) as usize);
    }
    let number = random.below(begins.len() as u64 - 1) as usize;
    let (at, behind) = (begins[number], &begins[number + 1..]);
    let len = (random.pick(behind) - at - head) as u64;
    bytes[at + 1..][..8].copy_from_slice(&len.to_le_bytes());
}

/// The messages of all publishers that have some. A gap is a metadata record, and MCAP has no checksum for it.
fn numbers(found: &BTreeMap<String, Found>) -> BTreeMap<&str, &[usize]> {
    let all = found
        .iter()
        .map(|(node, it)| (node.as_str(), &it.numbers[..]));
    all.filter(|it| !it.1.is_empty()).collect()
}
