//! The words that a machine hashes. Numbers that depend on its history are marked: they are renamed
//! when moments are compared (`print.rs`).
//!
//! A hasher is not told the meaning of the values that it gets. Therefore this harness chooses its
//! own numbers from ranges that no other number of a machine uses. The other numbers are recognised
//! by their positions.

use std::{
    collections::BTreeMap,
    hash::{Hash, Hasher},
};

use sm2_proto::{Instant, LinkId, NodeId, manager::Manager};

/// The first session number of each Manager.
pub(super) const SESSIONS: u64 = 7_000_000;
const SESSIONS_END: u64 = 8_000_000;
/// The first epoch.
pub(super) const EPOCHS: u64 = 0xE000_0000;
const EPOCHS_END: u64 = 0xE000_1000;
/// The time when each Manager starts. Time advances only to deadlines.
pub(super) const BEGIN: Instant = Instant(1_000_000_000_000_000);
const TIME_END: u64 = 2_000_000_000_000_000;
/// The start of each node's name; one digit follows.
pub(super) const NODE: &[u8] = b"node/";

/// The mask of the upper byte of a word, which is its kind. The rest is the number.
const KIND: u64 = 0xFF << 56;
const SESSION: u64 = 1 << 56;
const LINK: u64 = 2 << 56;
const TIME: u64 = 3 << 56;
const NAME: u64 = 4 << 56;
/// The key of the link that precedes it.
const KEY: u64 = 5 << 56;
/// The epoch's position in a link's word, above the serial number.
const EPOCH_AT: u32 = 40;

/// The key in the LINK frames of each link.
pub(super) type Keys = BTreeMap<LinkId, u64>;

/// One word of a tape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Word {
    Plain(u64),
    Session(u64),
    /// A link as in [`link_word`]: words are in the order of the ids.
    Link(u64),
    Time(u64),
    /// The name of the node with this index.
    Name(u8),
}

/// The words of a machine, and the links and sessions among them, in ascending order.
#[derive(Clone, Debug, Default)]
pub(super) struct Tape {
    words: Vec<u64>,
    pub(super) links: Vec<u64>,
    pub(super) sessions: Vec<u64>,
}

impl Tape {
    /// The tape of any value except a Manager.
    pub(super) fn of(keys: &Keys, what: &impl Hash) -> Self {
        let mut taker = Taker::new(keys, None);
        what.hash(&mut taker);
        taker.finished()
    }

    /// The tape of a Manager, without its revision (no node watches, and no change is remembered),
    /// and without the greatest numbers that it has assigned and seen (later numbers are always
    /// greater).
    pub(super) fn of_manager(keys: &Keys, manager: &Manager) -> Self {
        let mut taker = Taker::new(keys, Some(manager.revision()));
        manager.hash(&mut taker);
        taker.finished()
    }

    pub(super) fn words(&self) -> impl Iterator<Item = Word> {
        self.words.iter().map(|&word| {
            let rest = word & !KIND;
            match word & KIND {
                SESSION => Word::Session(rest),
                LINK => Word::Link(word),
                TIME => Word::Time(rest),
                NAME => Word::Name(u8::try_from(rest).unwrap_or(u8::MAX)),
                _ => Word::Plain(word),
            }
        })
    }
}

pub(super) const fn link_word(link: LinkId) -> u64 {
    LINK | (link.epoch.wrapping_sub(EPOCHS) << EPOCH_AT) | link.serial
}

/// The epoch of a link's word. Epochs are not renumbered, since the budget determines how many
/// there were.
pub(super) const fn epoch_of(word: u64) -> u64 {
    word >> EPOCH_AT
}

struct Taker<'a> {
    keys: &'a Keys,
    tape: Tape,
    /// An epoch, if a serial number may follow.
    epoch: Option<u64>,
    /// The link that was named last, if its key may follow.
    link: Option<LinkId>,
    /// The revision of a Manager.
    revision: Option<u64>,
    /// The number of 64-bit values so far, as long as it matters.
    numbers: usize,
    /// The next number is the serial number of the Manager's last link.
    last_serial: bool,
}

/// The positions of a Manager's 64-bit numbers. Its limits have 32 bits.
const LAST_SESSION_AT: usize = 0;
const REVISION_AT: usize = 1;

impl<'a> Taker<'a> {
    fn new(keys: &'a Keys, revision: Option<u64>) -> Self {
        Self {
            keys,
            tape: Tape {
                words: Vec::with_capacity(256),
                links: Vec::with_capacity(16),
                sessions: Vec::with_capacity(8),
            },
            epoch: None,
            link: None,
            revision,
            numbers: 0,
            last_serial: false,
        }
    }

    fn finished(mut self) -> Tape {
        self.plain_epoch();
        for list in [&mut self.tape.links, &mut self.tape.sessions] {
            list.sort_unstable();
            list.dedup();
        }
        self.tape.words.shrink_to_fit();
        self.tape
    }

    fn plain(&mut self, word: u64) {
        self.plain_epoch();
        self.tape.words.push(low(word));
    }

    fn plain_epoch(&mut self) {
        if let Some(epoch) = self.epoch.take() {
            self.tape.words.push(epoch);
        }
    }

    /// True if this number is left out: it is one of the Manager's numbers that only grow.
    fn is_left_out(&mut self, number: u64) -> bool {
        if std::mem::take(&mut self.last_serial) {
            return true;
        }
        let Some(revision) = self.revision else {
            return false;
        };
        self.numbers += 1;
        match self.numbers - 1 {
            REVISION_AT => {
                assert_eq!(number, revision, "the Manager's fields stand elsewhere now");
                true
            }
            LAST_SESSION_AT => {
                let session = number == 0 || is_session(number);
                assert!(session, "the Manager's fields stand elsewhere now");
                true
            }
            _ => false,
        }
    }
}

impl Hasher for Taker<'_> {
    fn finish(&self) -> u64 {
        0
    }

    fn write(&mut self, bytes: &[u8]) {
        let digit = bytes.strip_prefix(NODE);
        if let Some(&[digit @ b'0'..=b'9']) = digit {
            self.plain_epoch();
            self.tape.words.push(NAME | u64::from(digit - b'0'));
            return;
        }
        self.plain(bytes.len() as u64);
        for chunk in bytes.chunks(7) {
            let word = chunk
                .iter()
                .fold(0, |word, &byte| word << 8 | u64::from(byte));
            self.tape.words.push(word);
        }
    }

    fn write_u8(&mut self, byte: u8) {
        // The end of a text needs no word, because its length is a word already.
        if byte != 0xFF {
            self.plain(u64::from(byte));
        }
    }

    fn write_u16(&mut self, number: u16) {
        self.plain(u64::from(number));
    }

    fn write_u32(&mut self, number: u32) {
        self.plain(u64::from(number));
    }

    fn write_u64(&mut self, number: u64) {
        if self.is_left_out(number) {
            return;
        }
        if is_session(number) {
            self.plain_epoch();
            self.tape.words.push(SESSION | (number - SESSIONS));
            self.tape.sessions.push(number - SESSIONS);
        } else if let Some(epoch) = self.epoch.take() {
            let epoch = epoch + EPOCHS;
            let serial = number;
            let link = LinkId { epoch, serial };
            self.tape.words.push(link_word(link));
            self.tape.links.push(link_word(link));
            self.link = Some(link);
        } else if (EPOCHS..EPOCHS_END).contains(&number) {
            self.epoch = Some(number - EPOCHS);
        } else if (BEGIN.0..TIME_END).contains(&number) {
            self.tape.words.push(TIME | (number - BEGIN.0));
        } else if self.link.and_then(|link| self.keys.get(&link)) == Some(&number) {
            self.tape.words.push(KEY);
        } else {
            self.plain(number);
        }
    }

    fn write_u128(&mut self, secret: u128) {
        // The Manager's secret, which follows from its epoch, and then the serial number of its
        // last link.
        self.plain(low(secret as u64));
        self.last_serial = true;
    }

    fn write_usize(&mut self, number: usize) {
        self.plain(number as u64);
    }

    fn write_i32(&mut self, number: i32) {
        self.plain(u64::from(number.cast_unsigned()));
    }

    fn write_isize(&mut self, number: isize) {
        self.plain(number.cast_unsigned() as u64);
    }
}

fn is_session(number: u64) -> bool {
    (SESSIONS..SESSIONS_END).contains(&number)
}

/// A number without a kind. A number that is too long loses its lowest byte.
const fn low(number: u64) -> u64 {
    if number & KIND == 0 {
        number
    } else {
        number.rotate_left(32).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 8
    }
}

/// The number of a session, as in a session's word.
pub(super) const fn session_number(session: NodeId) -> u64 {
    session.0.wrapping_sub(SESSIONS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(what: &impl Hash) -> Vec<Word> {
        Tape::of(&Keys::new(), what).words().collect()
    }

    #[test]
    fn a_number_without_a_kind_keeps_its_value_or_is_mixed() {
        for number in [0, 1, 0x00FF_FFFF_FFFF_FFFF] {
            assert_eq!(low(number), number);
        }
        let long = [KIND, SESSION | 1, LINK | 1, u64::MAX].map(low);
        for (at, it) in long.iter().enumerate() {
            assert_eq!(it & KIND, 0, "it would read as another kind");
            assert!(!long[..at].contains(it), "{it:x}");
        }
    }

    #[test]
    fn each_byte_of_a_text_counts() {
        assert_eq!(words(&"node/3")[..1], [Word::Name(3)]);
        let text = words(&"abcdefgh");
        for other in ["abcdefgi", "bbcdefgh", "abcdefg", "abcxefgh"] {
            assert_ne!(words(&other), text, "{other}");
        }
    }
}
