//! Counter files with arbitrary contents, as `sm2 top` and other commands read them.

use std::{
    fs::File,
    os::{fd::OwnedFd, unix::fs::FileExt},
};

use nix::{
    fcntl::{FcntlArg, SealFlag, fcntl},
    sys::memfd::{MFdFlags, memfd_create},
};
use sm2_io::{
    CounterView,
    counters::{CounterError, Unreadable},
};
use sm2_proto::{
    Instant, Name, Seals,
    counters::{ENTRY_BYTES, ENTRY_FIELDS, Entry, field, header},
    domain::{Domain, Mirror},
    fuzz::Script,
};

use crate::{sampling::Sample, top, view::View};

/// Sets of seals of a file. Each lacks a seal that another one has.
const SEALS: [u32; 4] = [
    Seals::POOLED.0,
    Seals::POOLED.0 & !Seals::SHRINK.0,
    Seals::SEAL.0,
    0,
];
/// The largest number of entries of a file, and the number that its header may claim.
const ENTRIES_MAX: usize = 3;

/// A file is opened if and only if it is a valid counter file. Each entry reads as its words say, or not at
/// all. The tables of `sm2 top` can be drawn from any entries.
//= SM2-CNT-004, SM2-CNT-005, SM2-CNT-006 fuzz
pub(super) fn file(data: &[u8]) {
    let mut script = Script::new(data);
    if let Some((before, now)) = pages(&mut script) {
        figures(&mut script, &before, &now);
    }
}

/// Two files: the second is the first with some words changed.
fn pages(script: &mut Script<'_>) -> Option<(CounterView, CounterView)> {
    let flags = script.byte()?;
    let entries = 1 + usize::from(flags & 3) % ENTRIES_MAX;
    let mut words = header(u32::try_from(entries).ok()?).to_vec();
    words.resize(ENTRY_FIELDS * (1 + entries), 0);
    for entry in words.chunks_mut(ENTRY_FIELDS).skip(1) {
        (entry[field::TURN], entry[field::KIND]) = (2, 2);
    }
    let seals = Seals(SEALS[usize::from(flags >> 2 & 7).saturating_sub(4)]);
    let extra = usize::from(flags >> 5 == 7);
    change(script, &mut words)?;
    let before = open(&words, extra, seals);
    change(script, &mut words)?;
    let now = open(&words, extra, seals);
    Some((before?, now?))
}

/// Changes of words: pairs of an index and a new value.
fn change(script: &mut Script<'_>, words: &mut [u64]) -> Option<()> {
    for pair in script.bytes()?.chunks_exact(2) {
        // Only one change in four may hit the header.
        let entry = usize::from(pair[0] >> 6) % (words.len() / ENTRY_FIELDS);
        let at = ENTRY_FIELDS * entry + usize::from(pair[0]) % ENTRY_FIELDS;
        words[at] = match pair[1] {
            u8::MAX => u64::MAX,
            0xfe => words[at].wrapping_add(1),
            0xfd => 1 << 63,
            byte => u64::from(byte % 0x20) << (8 * (byte >> 5)),
        };
    }
    Some(())
}

/// Opens a file of these words and some extra bytes, if it is a valid counter file.
fn open(words: &[u64], extra: usize, seals: Seals) -> Option<CounterView> {
    let file = memfd(words, extra, seals);
    let entries = words.len() / ENTRY_FIELDS - 1;
    let head = header(u32::try_from(entries).ok()?);
    let size_bytes = ENTRY_BYTES * (1 + entries as u64) + extra as u64;
    let view = match CounterView::open(file) {
        Ok(view) => view,
        Err(CounterError::Seals { seals: found }) => {
            assert!(found == seals && !seals.contains(Seals::POOLED));
            return None;
        }
        Err(CounterError::Size { size_bytes: found }) => {
            assert!(found == size_bytes && extra > 0);
            return None;
        }
        Err(CounterError::Header) => {
            assert_ne!(words[..ENTRY_FIELDS], head);
            return None;
        }
        Err(other) => panic!("{other}"),
    };
    assert!(seals.contains(Seals::POOLED) && extra == 0);
    assert_eq!(
        (view.capacity() as usize, &words[..ENTRY_FIELDS]),
        (entries, &head[..])
    );
    entries_are_their_words(&view, &words[ENTRY_FIELDS..]);
    Some(view)
}

fn memfd(words: &[u64], extra: usize, seals: Seals) -> OwnedFd {
    let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    bytes.resize(bytes.len() + extra, 0);
    let fd = memfd_create(c"other", MFdFlags::MFD_ALLOW_SEALING).expect("a descriptor is free");
    let file = File::from(fd);
    file.write_all_at(&bytes, 0).expect("memory is free");
    let seals = SealFlag::from_bits_retain(seals.0.cast_signed());
    fcntl(&file, FcntlArg::F_ADD_SEALS(seals)).expect("nothing is sealed yet");
    file.into()
}

fn entries_are_their_words(view: &CounterView, words: &[u64]) {
    let mut expected = Vec::new();
    for (index, words) in (0..).zip(words.chunks_exact(ENTRY_FIELDS)) {
        let words: &[u64; ENTRY_FIELDS] = words.try_into().expect("a whole entry");
        let entry = match words[field::TURN] {
            0 => None,
            turn if turn % 2 == 1 => Some(Err(Unreadable::Torn)),
            _ => Some(Entry::from_words(words).ok_or(Unreadable::Malformed)),
        };
        assert_eq!(view.read(index).transpose(), entry);
        expected.extend(entry.map(|entry| (index, entry)));
    }
    assert!(view.entries().eq(expected));
}

/// The tables of a domain where the node of each name has these counters.
fn figures(script: &mut Script<'_>, before: &CounterView, now: &CounterView) {
    let Some(domain) = domain(script) else {
        return;
    };
    let view = View::new(&domain);
    let nodes: Vec<Name> = domain.nodes().map(|node| node.name.clone()).collect();
    let sample = |at, file| {
        // The last node keeps no counters.
        let known = nodes.iter().enumerate();
        let files = known.map(|(at, name)| (name.clone(), (at < 3).then_some(file)));
        Sample::new(Instant(at), files)
    };
    // Two samples of the same time, and two in the wrong order.
    for (earlier, later) in [(0, 1_000_000_000), (7, 7), (u64::MAX, 1)] {
        top::fuzz::figures(&view, &sample(earlier, before), &sample(later, now));
    }
}

fn domain(script: &mut Script<'_>) -> Option<Domain> {
    let mut items = script.items()?;
    items.sort_by_key(sm2_proto::control::Item::key);
    items.dedup_by_key(|item| item.key());
    let mut mirror = Mirror::new();
    mirror.page(1, items, None).ok()?;
    Some(mirror.into_domain())
}
