//! Counters between a writer and its readers.

use std::fs::File;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{FileExt, MetadataExt};
use std::sync::atomic::{AtomicBool, Ordering};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, SealFlag, fcntl};
use nix::sys::memfd::{MFdFlags, memfd_create};
use sm2_io::counters::{CounterError, Unreadable};
use sm2_io::{CounterPage, CounterView};
use sm2_proto::counters::{ENTRY_BYTES, Entry, MAX_ENTRIES, field, header};
use sm2_proto::link::{Counters, Fate};
use sm2_proto::{Instant, InterfaceId, LinkId, Seals};

/// The time when an entry begins, for entries that are compared with default ones.
const BEGIN: Instant = Instant(0);

const LINK: LinkId = LinkId {
    epoch: 7,
    serial: 9,
};

fn view(page: &CounterPage) -> CounterView {
    CounterView::open(page.as_fd().try_clone_to_owned().unwrap()).unwrap()
}

/// Reads the turn of an entry from the file.
fn turn(page: &CounterPage, index: u32) -> u64 {
    let file = File::from(page.as_fd().try_clone_to_owned().unwrap());
    let mut word = [0; 8];
    let offset = (u64::from(index) + 1) * ENTRY_BYTES + 8 * field::TURN as u64;
    file.read_exact_at(&mut word, offset).unwrap();
    u64::from_le_bytes(word)
}

/// Creates a memfd as another process may create it.
fn file(words: &[u64], len: u64, seals: Seals) -> OwnedFd {
    let file = File::from(memfd_create(c"other", MFdFlags::MFD_ALLOW_SEALING).unwrap());
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    file.write_all_at(&bytes, 0).unwrap();
    file.set_len(len).unwrap();
    let flags = SealFlag::from_bits_retain(seals.0.cast_signed());
    fcntl(&file, FcntlArg::F_ADD_SEALS(flags)).unwrap();
    file.into()
}

/// Creates a file with the given entries.
fn file_with(entries: &[[u64; 64]]) -> CounterView {
    let count = u32::try_from(entries.len()).unwrap();
    let mut words = header(count).to_vec();
    words.extend(entries.iter().flatten());
    let len = 8 * words.len() as u64;
    CounterView::open(file(&words, len, Seals::POOLED)).unwrap()
}

//= SM2-CNT-004 test
#[test]
fn a_file_that_only_its_author_can_write() {
    let page = CounterPage::new().unwrap();
    let facts = sm2_io::memfd::facts(page.as_fd()).unwrap();
    assert!(facts.regular && facts.seals.contains(Seals::POOLED));
    assert_eq!(facts.size_bytes, 4_194_304);
    let file = File::from(page.as_fd().try_clone_to_owned().unwrap());
    assert_eq!(
        file.write_at(b"x", 0).unwrap_err().raw_os_error(),
        Some(Errno::EPERM as i32)
    );
    let mut head = [0xff; 512];
    file.read_exact_at(&mut head, 0).unwrap();
    assert_eq!(&head[..16], b"SM2C\x01\0\0\0\xff\x1f\0\0\0\0\0\0");
    assert_eq!(head[16..], [0; 496]);
    let view = view(&page);
    assert_eq!(view.capacity(), MAX_ENTRIES);
    assert_eq!(view.entries().count(), 0);
}

//= SM2-CNT-005 test
#[test]
fn held_messages_and_the_begin_of_an_entry_are_seen() {
    let mut page = CounterPage::new().unwrap();
    let created = Instant(77);
    let mut receiver = page.allocate(InterfaceId(1), Some(LINK), created).unwrap();
    let view = view(&page);
    let shown = |index| view.read(index).unwrap().unwrap();
    receiver.update().max_held(9);
    for held in [2, 0, 9] {
        receiver.update().held(held);
        let entry = shown(receiver.index());
        assert_eq!(
            (entry.held, entry.max_held, entry.created),
            (held, 9, created)
        );
    }
}

//= SM2-CNT-005 test
#[test]
fn what_is_counted_is_seen() {
    let mut page = CounterPage::new().unwrap();
    let mut sender = page.allocate(InterfaceId(1), Some(LINK), BEGIN).unwrap();
    let mut receiver = page.allocate(InterfaceId(2), None, BEGIN).unwrap();
    let view = view(&page);
    let of = |id, link| Entry {
        interface: InterfaceId(id),
        link,
        ..Entry::default()
    };
    let (mut sent, mut got) = (of(1, Some(LINK)), of(2, None));
    assert_eq!(view.read(sender.index()), Ok(Some(sent.clone())));
    let seen: Vec<_> = view.entries().collect();
    assert_eq!(seen, [(0, Ok(sent.clone())), (1, Ok(got.clone()))]);

    for message in 1..=40 {
        let at = Instant(1_000 * message);
        let mut update = sender.update();
        update.published(at, 10);
        let mut fates = Counters {
            offered: message,
            in_flight: 5,
            ..Counters::default()
        };
        for (place, fate) in Fate::ALL.into_iter().enumerate() {
            *fates.of_mut(fate) = message * (place as u64 + 2);
        }
        update.fates(&fates);
        let short_since = (message % 2 == 1).then_some(at);
        update.short_since(short_since);
        update.unheard();
        update.missed_deadlines(3);
        drop(update);
        let mut update = receiver.update();
        update.lost_liveliness();
        update.away(3);
        update.taken(at, Instant(at.0 - 100 + message), 20);
        update.lost(2);
        update.expired(2);
        drop(update);
        let place = (message as usize - 1) % 32;
        sent.messages = message;
        sent.bytes += 10;
        sent.last = at;
        sent.fates = fates;
        sent.short_since = short_since;
        sent.unheard += 1;
        sent.missed_deadlines += 3;
        sent.recent_ns[place] = at.0;
        got.messages = message;
        got.bytes += 20;
        got.last = at;
        (got.lost, got.lost_liveliness, got.away) = (2 * message, message, 3 * message);
        got.fates.expired += 2;
        got.delay_sum_ns += 100 - message;
        got.delay_max_ns = 99;
        got.recent_ns[place] = 100 - message;
        assert_eq!(view.read(sender.index()), Ok(Some(sent.clone())));
        assert_eq!(view.read(receiver.index()), Ok(Some(got.clone())));
    }
    // The publication time is later than the time of taking.
    receiver.update().taken(Instant(5), Instant(9), 0);
    let seen = view.read(receiver.index()).unwrap().unwrap();
    assert_eq!(seen.delay_sum_ns, got.delay_sum_ns);
    assert_eq!(seen.recent().last(), Some(0));
}

#[test]
fn looking_changes_nothing() {
    let mut page = CounterPage::new().unwrap();
    let entries: Vec<_> = (1..=30)
        .map(|id| page.allocate(InterfaceId(id), None, BEGIN).unwrap())
        .collect();
    let state = || {
        let file = File::from(page.as_fd().try_clone_to_owned().unwrap());
        let metadata = file.metadata().unwrap();
        let turns: Vec<_> = entries.iter().map(|e| turn(&page, e.index())).collect();
        (metadata.blocks(), metadata.mtime_nsec(), turns)
    };
    let before = state();
    assert!(before.0 * 512 < 1 << 20, "a sparse file: {before:?}");
    let seen = view(&page).entries().count();
    assert_eq!((seen, state()), (30, before));
}

//= SM2-CNT-006 test
#[test]
fn an_entry_is_used_again_but_never_its_turns() {
    let mut page = CounterPage::new().unwrap();
    let view = view(&page);
    let mut all: Vec<_> = (0..MAX_ENTRIES)
        .map(|id| {
            page.allocate(InterfaceId(u64::from(id) + 1), None, BEGIN)
                .unwrap()
        })
        .collect();
    assert!(page.allocate(InterfaceId(9), None, BEGIN).is_none());
    assert_eq!(view.entries().count(), 8_191);
    let last = view.read(MAX_ENTRIES - 1).unwrap().unwrap();
    assert_eq!(last.interface, InterfaceId(8_191));

    let mut entry = all.swap_remove(4_000);
    let first = turn(&page, 4_000);
    entry.update().published(Instant(5), 5);
    let latest = turn(&page, 4_000);
    assert!(latest > first);
    page.free(entry);
    assert_eq!((turn(&page, 4_000), view.read(4_000)), (0, Ok(None)));
    assert_eq!(view.entries().count(), 8_190);

    let entry = page.allocate(InterfaceId(77), Some(LINK), BEGIN).unwrap();
    assert_eq!(entry.index(), 4_000);
    let blank = Entry {
        interface: InterfaceId(77),
        link: Some(LINK),
        ..Entry::default()
    };
    assert_eq!(view.read(4_000), Ok(Some(blank)));
    assert!(turn(&page, 4_000) > latest && turn(&page, 4_000).is_multiple_of(2));
}

//= SM2-CNT-006 test
#[test]
fn a_change_that_does_not_end_is_reported() {
    let mut page = CounterPage::new().unwrap();
    let view = view(&page);
    let mut entry = page.allocate(InterfaceId(1), None, BEGIN).unwrap();
    let mut update = entry.update();
    update.published(Instant(1), 1);
    assert_eq!(view.read(0), Err(Unreadable::Torn));
    assert_eq!(
        view.entries().collect::<Vec<_>>(),
        [(0, Err(Unreadable::Torn))]
    );
    std::mem::forget(update);
    // The next change repairs the entry.
    entry.update().published(Instant(2), 1);
    assert_eq!(view.read(0).unwrap().unwrap().messages, 2);
}

//= SM2-CNT-006 test
#[test]
fn a_reader_never_sees_half_a_change() {
    let mut page = CounterPage::new().unwrap();
    let view = view(&page);
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            // Two allocations use the same entry in turn: their counts must never mix.
            while !done.load(Ordering::Relaxed) {
                for id in 1..=2 {
                    let mut entry = page.allocate(InterfaceId(id), None, BEGIN).unwrap();
                    for message in 1..=100 {
                        let mut update = entry.update();
                        update.published(Instant(message * id), message);
                        update.lost(id);
                        let mut fates = Counters::default();
                        (fates.offered, fates.in_flight) = (message, message * id);
                        update.fates(&fates);
                        drop(update);
                        // Sometimes pauses long enough for a reader to copy the entry.
                        (0..message % 8 * 100).for_each(|_| std::hint::spin_loop());
                    }
                    page.free(entry);
                }
            }
        });
        // Also ends the writer if an assertion fails.
        let _end = EndOnDrop(&done);
        let (mut seen, mut free, mut torn) = (0_u32, 0_u32, 0_u32);
        while seen < 20_000 {
            match view.read(0) {
                Ok(Some(entry)) => {
                    seen += 1;
                    assert_consistent(&entry);
                }
                Ok(None) => free += 1,
                Err(Unreadable::Torn) => torn += 1,
                Err(error) => panic!("{error}"),
            }
        }
        println!("{seen} entries, {free} free, {torn} torn");
    });
}

struct EndOnDrop<'a>(&'a AtomicBool);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn assert_consistent(entry: &Entry) {
    let (id, messages) = (entry.interface.0, entry.messages);
    assert!((1..=2).contains(&id) && messages <= 100, "{entry:?}");
    assert_eq!(entry.bytes, messages * (messages + 1) / 2, "{entry:?}");
    assert_eq!(entry.last, Instant(messages * id), "{entry:?}");
    assert_eq!(entry.lost, messages * id, "{entry:?}");
    assert_eq!(entry.fates.offered, messages, "{entry:?}");
    assert_eq!(entry.fates.in_flight, messages * id, "{entry:?}");
    let noted = entry.recent().len() as u64;
    let expected = (messages - noted + 1..=messages).map(|m| m * id);
    assert!(entry.recent().eq(expected), "{entry:?}");
}

//= SM2-CNT-004 test
#[test]
fn files_that_are_not_of_counters() {
    let words = header(1);
    let open = |fd: OwnedFd| CounterView::open(fd).unwrap_err();
    let not_memory: OwnedFd = tempfile::tempfile().unwrap().into();
    assert!(matches!(open(not_memory), CounterError::NotAMemfd));
    let (pipe, _end) = nix::unistd::pipe().unwrap();
    assert!(matches!(open(pipe), CounterError::NotAMemfd));

    CounterView::open(file(&words, 1_024, Seals::POOLED)).unwrap();
    for missing in [
        Seals::SEAL,
        Seals::SHRINK,
        Seals::GROW,
        Seals::FUTURE_WRITE,
        Seals::POOLED,
    ] {
        let seals = Seals(Seals::POOLED.0 & !missing.0);
        let error = open(file(&words, 1_024, seals));
        assert!(matches!(error, CounterError::Seals { .. }), "{missing:?}");
    }
    for size in [512, 1_023, 1_025, 4_194_304 + 512, 1 << 40] {
        let error = open(file(&words, size, Seals::POOLED));
        assert!(
            matches!(error, CounterError::Size { size_bytes } if size_bytes == size),
            "{size} bytes: {error}"
        );
    }
    // The wrong number of entries, another version, and non-zero bytes after the header.
    let mut wrong = vec![header(2), header(0), [0; 64], header(1), header(1)];
    wrong[3][0] += 1 << 32;
    wrong[4][63] = 1;
    for words in wrong {
        let error = open(file(&words, 1_024, Seals::POOLED));
        assert!(matches!(error, CounterError::Header), "{words:?}: {error}");
    }
}

//= SM2-CNT-005 test
//= SM2-CNT-006 test
#[test]
fn entries_that_are_not_as_they_should_be() {
    let good = Entry {
        interface: InterfaceId(3),
        ..Entry::default()
    };
    let (mut unknown, mut odd) = (good.to_words(2), good.to_words(2));
    unknown[field::KIND] = 99;
    odd[field::TURN] = u64::MAX;
    let free = good.to_words(0);
    let noise = [0xaaaa_aaaa_aaaa_aaaa; 64];
    let view = file_with(&[unknown, free, odd, noise, good.to_words(u64::MAX - 1)]);
    let seen: Vec<_> = view.entries().collect();
    assert_eq!(
        seen,
        [
            (0, Err(Unreadable::Malformed)),
            (2, Err(Unreadable::Torn)),
            (3, Err(Unreadable::Malformed)),
            (4, Ok(good)),
        ]
    );
}

//= SM2-CNT-006 test
#[test]
fn a_file_full_of_changes_that_do_not_end() {
    let good = Entry::default().to_words(2);
    let mut entries = vec![Entry::default().to_words(3); MAX_ENTRIES as usize];
    *entries.last_mut().unwrap() = good;
    let view = file_with(&entries);
    let torn = view
        .entries()
        .filter(|(_, read)| *read == Err(Unreadable::Torn));
    assert_eq!(torn.count(), 8_190);
    // Even with no attempts left, complete entries are read.
    assert_eq!(view.entries().last(), Some((8_190, Ok(Entry::default()))));
}

#[test]
fn entries_beyond_a_hole_are_found() {
    let good = Entry::default().to_words(2);
    let mut words = header(MAX_ENTRIES).to_vec();
    words.resize(64 * 8_192, 0);
    let len = 8 * words.len() as u64;
    let file = File::from(memfd_create(c"other", MFdFlags::MFD_ALLOW_SEALING).unwrap());
    file.set_len(len).unwrap();
    let put = |first: usize, words: &[u64]| {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        file.write_all_at(&bytes, 8 * first as u64).unwrap();
    };
    put(0, &words[..64]);
    let places = [0, 6, 7, 100, 5_000, 8_190];
    for index in places {
        put((index + 1) * 64, &good);
    }
    let flags = SealFlag::from_bits_retain(Seals::POOLED.0.cast_signed());
    fcntl(&file, FcntlArg::F_ADD_SEALS(flags)).unwrap();
    let before = file.metadata().unwrap().blocks();
    let view = CounterView::open(file.as_fd().try_clone_to_owned().unwrap()).unwrap();
    let seen: Vec<_> = view.entries().map(|(index, _)| index as usize).collect();
    assert_eq!(seen, places);
    assert_eq!(file.metadata().unwrap().blocks(), before);
}

#[test]
#[should_panic(expected = "entry 1 of 1")]
fn an_entry_that_does_not_exist() {
    let _ = file_with(&[[0; 64]]).read(1);
}
