//! Counters as words, and the arithmetic over them.

use core::{ops::RangeInclusive, time::Duration};
use std::collections::BTreeMap;

use sm2_proto::counters::{
    ENTRY_FIELDS, Entry, MAGIC, MAX_ENTRIES, MAX_FILE_BYTES, RECENT, Summary, entries_in, field,
    header, recent_index,
};
use sm2_proto::{Instant, InterfaceId, LinkId, link};

/// The fields of an entry and their positions, from the table in SPEC.
fn fields() -> BTreeMap<&'static str, RangeInclusive<usize>> {
    let spec = include_str!("../../SPEC.md");
    let (_, table) = spec.split_once("| 0 | `turn` |").expect("the table");
    let rows = table.lines().skip(1).take_while(|it| it.starts_with('|'));
    let number = |it: &str| it.trim().parse::<usize>().expect("a position");
    let mut fields = BTreeMap::new();
    for row in rows {
        let mut cells = row.split('|').skip(1).map(str::trim);
        let (positions, names) = (cells.next().expect("a cell"), cells.next().expect("a cell"));
        let (first, last) = positions
            .split_once(" to ")
            .or_else(|| positions.split_once(", "))
            .unwrap_or((positions, positions));
        let (first, last) = (number(first), number(last));
        let names: Vec<_> = names.split(", ").map(|it| it.trim_matches('`')).collect();
        match &*names {
            [one] => _ = fields.insert(*one, first..=last),
            all => {
                assert_eq!(all.len(), last + 1 - first, "{row}");
                fields.extend(all.iter().zip(first..).map(|(it, at)| (*it, at..=at)));
            }
        }
    }
    fields
}

/// Each fate holds the position of its name.
fn fates() -> link::Counters {
    let fields = fields();
    let mut fates = link::Counters {
        offered: 9,
        in_flight: 15,
        ..link::Counters::default()
    };
    for fate in link::Fate::ALL {
        *fates.of_mut(fate) = *fields[fate.as_str()].start() as u64;
    }
    fates
}

fn link_end() -> Entry {
    Entry {
        interface: InterfaceId(2),
        link: Some(LinkId {
            epoch: 3,
            serial: 4,
        }),
        messages: 5,
        bytes: 6,
        last: Instant(7),
        lost: 8,
        fates: fates(),
        delay_sum_ns: 16,
        delay_max_ns: 17,
        short_since: Some(Instant(20)),
        unheard: 21,
        missed_deadlines: 22,
        lost_liveliness: 24,
        away: 25,
        held: 26,
        max_held: 27,
        created: Instant(28),
        recent_ns: core::array::from_fn(|index| 32 + index as u64),
    }
}

/// Each field holds its own index, except the turn, the kind and the reserved words.
//= SM2-CNT-005 test
#[test]
fn every_field_has_its_place() {
    let mut expected: [u64; ENTRY_FIELDS] = core::array::from_fn(|index| index as u64);
    expected[0] = 42;
    expected[1] = 2;
    expected[fields()["reserved"].clone()].fill(0);
    assert_eq!(link_end().to_words(42), expected);
    assert_eq!(Entry::from_words(&expected), Some(link_end()));
    let interface = Entry {
        link: None,
        ..link_end()
    };
    expected[1] = 1;
    expected[3..5].fill(0);
    assert_eq!(interface.to_words(42), expected);
    assert_eq!(Entry::from_words(&expected), Some(interface));
}

//= SM2-CNT-005 test
//= SM2-CNT-006 test
#[test]
fn what_is_not_an_entry() {
    let good = link_end().to_words(2);
    let with = |index: usize, value: u64| {
        let mut words = good;
        words[index] = value;
        Entry::from_words(&words)
    };
    assert!(with(field::TURN, u64::MAX - 1).is_some());
    for turn in [0, 1, 3, u64::MAX] {
        assert_eq!(with(field::TURN, turn), None, "turn {turn}");
    }
    // Kind 1 is an interface, which has no link.
    for kind in [0, 1, 3, u64::MAX] {
        assert_eq!(with(field::KIND, kind), None, "kind {kind}");
    }
    for reserved in field::RESERVED..field::RECENT {
        assert_eq!(with(reserved, 1), None, "field {reserved}");
    }
    let mut interface = Entry::default().to_words(2);
    assert_eq!(Entry::from_words(&interface), Some(Entry::default()));
    interface[field::LINK_EPOCH] = 1;
    assert_eq!(Entry::from_words(&interface), None);
}

//= SM2-CNT-004 test
#[test]
fn sizes_and_headers() {
    assert_eq!((MAX_ENTRIES, MAX_FILE_BYTES), (8_191, 4_194_304));
    assert_eq!(MAGIC, 0x0000_0001_4332_4d53);
    assert_eq!(&MAGIC.to_le_bytes(), b"SM2C\x01\0\0\0");
    let table = [
        (0, None),
        (512, None),
        (1_023, None),
        (1_024, Some(1)),
        (1_025, None),
        (1_536, Some(2)),
        (4_194_304, Some(8_191)),
        (4_194_304 + 512, None),
        (u64::MAX - 511, None),
        (u64::MAX, None),
    ];
    for (size, entries) in table {
        assert_eq!(entries_in(size), entries, "{size} bytes");
    }
    let words = header(7);
    assert_eq!(words[..2], [MAGIC, 7]);
    assert_eq!(words[2..], [0; 62]);
}

//= SM2-CNT-005 test
#[test]
fn recent_messages_come_oldest_first() {
    assert_eq!(
        [1, 2, 32, 33, 64, 65].map(recent_index),
        [0, 1, 31, 0, 31, 0]
    );
    // Message m is recorded with a delay of 100 m ns.
    let mut entry = Entry::default();
    assert_eq!(entry.recent().len(), 0);
    for message in 1..=100 {
        entry.messages = message;
        entry.recent_ns[recent_index(message)] = 100 * message;
        let first = message.saturating_sub(RECENT as u64) + 1;
        let expected: Vec<u64> = (first..=message).map(|m| 100 * m).collect();
        assert_eq!(entry.recent().collect::<Vec<_>>(), expected);
    }
    entry.messages = u64::MAX;
    assert_eq!(entry.recent().len(), RECENT);
}

#[test]
fn gaps_between_messages() {
    let sent = |times: &[u64]| {
        let mut entry = Entry {
            messages: times.len() as u64,
            ..Entry::default()
        };
        entry.recent_ns[..times.len()].copy_from_slice(times);
        entry.gaps()
    };
    assert_eq!(sent(&[]), None);
    assert_eq!(sent(&[5]), None);
    let gaps = sent(&[1_000, 3_000, 7_000]).unwrap();
    let expected = Summary {
        count: 2,
        mean_ns: 3_000,
        min_ns: 2_000,
        max_ns: 4_000,
        std_dev_ns: 1_000,
    };
    assert_eq!(gaps, expected);
    assert_eq!(gaps.per_second(), Some(1e9 / 3_000.0));
    // A clock that runs backwards is a lie: no more than that.
    let lie = sent(&[10, 5, 5]).unwrap();
    assert_eq!((lie.max_ns, lie.per_second()), (0, None));
}

#[test]
fn delays() {
    let mut entry = Entry {
        messages: 40,
        delay_sum_ns: 401,
        ..Entry::default()
    };
    entry.recent_ns = [10; RECENT];
    entry.recent_ns[3] = 42;
    let recent = entry.recent_delays().unwrap();
    assert_eq!((recent.count, recent.mean_ns, recent.max_ns), (32, 11, 42));
    assert_eq!(entry.mean_delay_ns(), Some(10));
    assert_eq!(Entry::default().mean_delay_ns(), None);
    assert_eq!(Entry::default().recent_delays(), None);
}

#[test]
fn no_number_is_too_large() {
    let entry = Entry {
        messages: u64::MAX,
        recent_ns: core::array::from_fn(|index| if index % 2 == 0 { 0 } else { u64::MAX }),
        ..Entry::default()
    };
    let delays = entry.recent_delays().unwrap();
    assert_eq!((delays.min_ns, delays.max_ns), (0, u64::MAX));
    assert_eq!(delays.mean_ns, u64::MAX / 2);
    assert!(delays.std_dev_ns >= 1 << 61);
    assert!(entry.gaps().is_some());
    let all = Entry::from_words(&entry.to_words(u64::MAX - 1)).unwrap();
    assert!(all.rate_since(&all, Duration::MAX).is_some());
}

#[test]
fn rates_between_two_looks() {
    let earlier = link_end();
    let later = Entry {
        messages: earlier.messages + 100,
        bytes: earlier.bytes + 5_000,
        ..earlier.clone()
    };
    let half = Duration::from_millis(500);
    let rate = later.rate_since(&earlier, half).unwrap();
    assert_eq!((rate.messages_per_s, rate.bytes_per_s), (200.0, 10_000.0));
    assert_eq!(later.rate_since(&earlier, Duration::ZERO), None);
    assert_eq!(earlier.rate_since(&later, half), None, "less than before");
    let other = Entry {
        link: None,
        ..later.clone()
    };
    assert_eq!(other.rate_since(&earlier, half), None, "another entry");
}
