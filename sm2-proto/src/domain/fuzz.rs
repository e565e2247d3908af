//! The body of the fuzz target `domain_mirror`.

use alloc::{collections::BTreeMap, vec::Vec};
use core::time::Duration;

use super::{Ask, BrokenAnswer, Domain, Mirror};
use crate::{
    control::{Change, Item, Key},
    counters::{ENTRY_FIELDS, Entry, Summary},
    fuzz::script::Script,
};

/// A mirror holds exactly the items that the Manager has sent. It refuses only answers that were
/// not requested or that do not lead to a later state. A program that follows its changes has the
/// same items as the mirror. `query` asks what tools ask of the mirror's domain.
//= SM2-WCH-003 fuzz
pub(crate) fn mirror(data: &[u8], query: fn(&Domain)) {
    let mut fuzz = Fuzz {
        script: Script::new(data),
        mirror: Mirror::new(),
        follower: BTreeMap::new(),
        said: 0,
        query,
    };
    while fuzz.step().is_some() {
        fuzz.check();
    }
    query(fuzz.mirror.domain());
}

struct Fuzz<'a> {
    script: Script<'a>,
    mirror: Mirror,
    /// The state of a program that sees only the changes that the mirror returned.
    follower: BTreeMap<Key, Item>,
    /// The number of items that were sent.
    said: usize,
    query: fn(&Domain),
}

impl Fuzz<'_> {
    /// Does one operation; `None` when the bytes are used up.
    fn step(&mut self) -> Option<()> {
        let choice = self.script.byte()?;
        let before = self.mirror.clone();
        let asked = before.ask();
        let taken = match choice % 8 {
            0..=2 => {
                let revision = self.script.number()?;
                let mut items = self.script.items()?;
                if choice & 0x80 == 0 {
                    items.sort_by_key(Item::key);
                    items.dedup_by_key(|item| item.key());
                }
                let next = match choice >> 3 & 3 {
                    0 => Some(self.script.key()?),
                    1 => items.last().map(Item::key),
                    _ => None,
                };
                self.said += items.len();
                let taken = self.mirror.page(revision, items, next);
                let asked = matches!(asked, Some(Ask::Page { .. }));
                assert_eq!(taken == Err(BrokenAnswer::Unrequested), !asked);
                taken
            }
            3..=5 => {
                let revision = self.script.number()?;
                let revision = revision.saturating_add((choice >> 5).into());
                let changes = self.script.changes()?;
                self.said += changes.len();
                let changes = (choice & 8 == 0).then_some(changes);
                let taken = self.mirror.changes(revision, changes, choice & 0x10 != 0);
                let asked = !matches!(asked, Some(Ask::Page { .. }));
                assert_eq!(taken == Err(BrokenAnswer::Unrequested), !asked);
                taken
            }
            6 => {
                self.mirror.restart();
                assert_eq!(self.mirror.domain(), before.domain());
                Ok(Vec::new())
            }
            _ => {
                counters(&mut self.script)?;
                (self.query)(self.mirror.domain());
                Ok(Vec::new())
            }
        };
        match taken {
            Ok(changes) => self.follow(changes),
            Err(_) => assert_eq!(self.mirror, before, "nonsense changes nothing"),
        }
        Some(())
    }

    fn follow(&mut self, changes: Vec<Change>) {
        for change in changes {
            match change {
                Change::Set { item } => drop(self.follower.insert(item.key(), item)),
                Change::Removed { key } => drop(self.follower.remove(&key)),
            }
        }
    }

    fn check(&self) {
        let items: Vec<_> = self.mirror.domain().items().collect();
        assert!(items.len() <= self.said, "more than what was sent");
        assert!(self.follower.values().eq(items), "the changes tell it all");
    }
}

/// Words of a file whose author is not trusted.
//= SM2-CNT-005 fuzz
fn counters(script: &mut Script<'_>) -> Option<()> {
    let mut words = [0; ENTRY_FIELDS];
    // The turn and the kind of a legal entry, unless the bytes choose others.
    (words[0], words[1]) = (2, 2);
    let named = script.bytes()?;
    for pair in named.chunks_exact(2) {
        let word = &mut words[usize::from(pair[0]) % ENTRY_FIELDS];
        *word = match pair[1] {
            u8::MAX => u64::MAX,
            byte => u64::from(byte) << (8 * (pair[0] >> 6)),
        };
    }
    let Some(entry) = Entry::from_words(&words) else {
        return Some(());
    };
    let link = words[1] == 2;
    assert_eq!(entry.link.is_some(), link);
    let mut again = entry.to_words(words[0]);
    if link {
        assert_eq!(again, words, "an entry says what its words say");
    }
    again[1] = 0;
    assert_eq!(Entry::from_words(&again), None);
    assert!(entry.recent().len() <= 32);
    for summary in [entry.gaps(), entry.recent_delays()].into_iter().flatten() {
        check_summary(&summary);
    }
    let rate = entry.rate_since(&Entry::default(), Duration::from_nanos(1));
    assert!(rate.is_none_or(|rate| rate.messages_per_s.is_finite()));
    assert_eq!(entry.mean_delay_ns().is_some(), entry.messages > 0);
    Some(())
}

fn check_summary(summary: &Summary) {
    let range = summary.min_ns..=summary.max_ns;
    assert!(summary.count > 0 && range.contains(&summary.mean_ns));
    assert!(summary.std_dev_ns <= summary.max_ns - summary.min_ns);
    assert!(summary.per_second().is_none_or(f64::is_finite));
}
