//! The format of a node's counters in a shared file, and the figures that tools compute from them.
//!
//! The file is [`ENTRY_BYTES`] of header, then as many bytes for each entry. All fields are `u64`,
//! little-endian; [`field`] names them. `sm2-io` reads and writes the file. This module works on
//! words that were copied out, and its arithmetic takes any content, because the author of a file
//! is not trusted.
//!
//! Times and delays are nanoseconds; times are of the host's monotonic clock.

use core::time::Duration;

use crate::link::{Counters, Fate};
use crate::{Instant, InterfaceId, LinkId};

/// The first field of the header: the bytes `SM2C`, then the `u32` 1.
//= SM2-CNT-004
pub const MAGIC: u64 = u64::from_le_bytes(*b"SM2C\x01\0\0\0");

/// The fields of an entry, and of the header.
pub const ENTRY_FIELDS: usize = 64;

/// The size of an entry and of the header, in bytes.
pub const ENTRY_BYTES: u64 = 8 * ENTRY_FIELDS as u64;

/// The size of the largest file, in bytes.
pub const MAX_FILE_BYTES: u64 = 4_194_304;

/// The number of entries in the largest file.
pub const MAX_ENTRIES: u32 = (MAX_FILE_BYTES / ENTRY_BYTES) as u32 - 1;

/// The number of messages that an entry remembers one by one.
pub const RECENT: usize = 32;

/// The positions of an entry's fields (SM2-CNT-005), without those of [`Fate::position`].
//= SM2-CNT-005
#[allow(missing_docs, reason = "the fields of Entry say what they are")]
pub mod field {
    use crate::link::Fate;

    /// 0: not in use; odd: being written; even: grows with each change (SM2-CNT-006).
    pub const TURN: usize = 0;
    /// 1: an interface; 2: its end of a link.
    pub const KIND: usize = 1;
    pub const INTERFACE: usize = 2;
    pub const LINK_EPOCH: usize = 3;
    pub const LINK_SERIAL: usize = 4;
    pub const MESSAGES: usize = 5;
    pub const BYTES: usize = 6;
    pub const LAST: usize = 7;
    pub const LOST: usize = 8;
    pub const OFFERED: usize = 9;
    pub const IN_FLIGHT: usize = 15;
    pub const DELAY_SUM: usize = 16;
    pub const DELAY_MAX: usize = 17;
    pub const SHORT_SINCE: usize = 20;
    /// Messages that were published while no link was open.
    pub const UNHEARD: usize = 21;
    /// Periods of the deadline that passed without a message.
    pub const MISSED_DEADLINES: usize = 22;
    /// How often the publisher stopped being alive.
    pub const LOST_LIVELINESS: usize = 24;
    /// Messages that were published while their publisher had no link with the subscriber.
    pub const AWAY: usize = 25;
    /// Samples that the application has taken and not released.
    pub const HELD: usize = 26;
    /// The greatest number of samples that the application can hold.
    pub const MAX_HELD: usize = 27;
    pub const CREATED: usize = 28;
    /// The first of the fields that are zero, up to [`RECENT`].
    pub const RESERVED: usize = {
        let (mut last, mut at) = (CREATED, 0);
        while at < Fate::ALL.len() {
            let position = Fate::ALL[at].position();
            if position > last {
                last = position;
            }
            at += 1;
        }
        last + 1
    };
    /// The first of [`super::RECENT`] fields.
    pub const RECENT: usize = 32;
}

const _: () = assert!(field::RESERVED <= field::RECENT);
const _: () = assert!(field::RECENT + RECENT == ENTRY_FIELDS);

/// The field [`KIND`](field::KIND) of an interface as a whole.
pub const KIND_INTERFACE: u64 = 1;
/// The field [`KIND`](field::KIND) of one end of a link.
pub const KIND_LINK: u64 = 2;

/// The number of entries of a file of `size_bytes`; `None` if no file of counters has that size.
#[must_use]
//= SM2-CNT-004
pub const fn entries_in(size_bytes: u64) -> Option<u32> {
    if !size_bytes.is_multiple_of(ENTRY_BYTES)
        || size_bytes < 2 * ENTRY_BYTES
        || size_bytes > MAX_FILE_BYTES
    {
        return None;
    }
    Some((size_bytes / ENTRY_BYTES) as u32 - 1)
}

/// The fields of the header of a file with that many entries.
#[must_use]
//= SM2-CNT-004
pub const fn header(entries: u32) -> [u64; ENTRY_FIELDS] {
    let mut fields = [0; ENTRY_FIELDS];
    fields[0] = MAGIC;
    fields[1] = entries as u64;
    fields
}

/// The index of message number `message` (the first is 1) among the recent ones.
#[must_use]
//= SM2-CNT-005
pub const fn recent_index(message: u64) -> usize {
    (message.wrapping_sub(1) % RECENT as u64) as usize
}

/// The counters of one interface, or of its end of one link.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Entry {
    /// The interface.
    pub interface: InterfaceId,
    /// The link that has this end; `None` for the interface as a whole.
    pub link: Option<LinkId>,
    /// Messages published, or taken by the application; requests taken; calls sent.
    pub messages: u64,
    /// The sum of the lengths of these messages, in bytes.
    pub bytes: u64,
    /// The time when the last of them was published or taken; zero if there is none.
    pub last: Instant,
    /// Messages that were lost before the application saw them.
    pub lost: u64,
    /// The fates of the messages on the sending side of a link. On the receiving side, the messages that have expired.
    pub fates: Counters,
    /// The sum of the delays from publication to taking, on the receiving side. A program that takes messages in quick
    /// succession, one in less than 2 us, reads the clock once for up to 16 of them. Their delays end with that
    /// reading.
    pub delay_sum_ns: u64,
    /// The longest of these delays.
    pub delay_max_ns: u64,
    /// The time when the node became short of memory on the link; `None` while it is not.
    pub short_since: Option<Instant>,
    /// Messages of a publisher that were published while none of its links was open.
    pub unheard: u64,
    /// Periods of the deadline that passed without a message, of a publisher, a subscriber or its end of a link.
    pub missed_deadlines: u64,
    /// How often the publisher stopped being alive, of a publisher, a subscriber or its end of a link.
    pub lost_liveliness: u64,
    /// Messages that were published while their publisher had no link with the subscriber: of a subscriber, those of
    /// `lost`; of its end of a link, those before the link, which are not in `lost`.
    pub away: u64,
    /// Messages that the application has taken and not released, of a subscriber's end of a link.
    pub held: u64,
    /// The greatest number of messages that the application can hold, of a subscriber's end of a link.
    pub max_held: u64,
    /// The time when the entry was created; zero if it is not stated.
    pub created: Instant,
    /// The last messages, by [`recent_index`]: a sending side notes the time of each publication, a
    /// receiving side its delay. See [`recent`](Self::recent).
    pub recent_ns: [u64; RECENT],
}

impl Default for Entry {
    fn default() -> Self {
        Self {
            interface: InterfaceId(0),
            link: None,
            messages: 0,
            bytes: 0,
            last: Instant(0),
            lost: 0,
            fates: Counters::default(),
            delay_sum_ns: 0,
            delay_max_ns: 0,
            short_since: None,
            unheard: 0,
            missed_deadlines: 0,
            lost_liveliness: 0,
            away: 0,
            held: 0,
            max_held: 0,
            created: Instant(0),
            recent_ns: [0; RECENT],
        }
    }
}

impl Entry {
    /// Reads an entry. `None` if the entry is not in use, is being written, or breaks SM2-CNT-005:
    /// a kind that is unknown, an interface with a link, or a reserved field that is not zero.
    #[must_use]
    //= SM2-CNT-005
    pub fn from_words(words: &[u64; ENTRY_FIELDS]) -> Option<Self> {
        let turn = words[field::TURN];
        if turn == 0
            || turn % 2 == 1
            || words[field::RESERVED..field::RECENT] != [0; field::RECENT - field::RESERVED]
        {
            return None;
        }
        let link = LinkId {
            epoch: words[field::LINK_EPOCH],
            serial: words[field::LINK_SERIAL],
        };
        let link = match (words[field::KIND], link) {
            (KIND_LINK, link) => Some(link),
            (
                KIND_INTERFACE,
                LinkId {
                    epoch: 0,
                    serial: 0,
                },
            ) => None,
            _ => return None,
        };
        let mut recent_ns = [0; RECENT];
        recent_ns.copy_from_slice(&words[field::RECENT..]);
        let mut fates = Counters {
            offered: words[field::OFFERED],
            in_flight: words[field::IN_FLIGHT],
            ..Counters::default()
        };
        for fate in Fate::ALL {
            *fates.of_mut(fate) = words[fate.position()];
        }
        Some(Self {
            interface: InterfaceId(words[field::INTERFACE]),
            link,
            messages: words[field::MESSAGES],
            bytes: words[field::BYTES],
            last: Instant(words[field::LAST]),
            lost: words[field::LOST],
            fates,
            delay_sum_ns: words[field::DELAY_SUM],
            delay_max_ns: words[field::DELAY_MAX],
            short_since: match words[field::SHORT_SINCE] {
                0 => None,
                since => Some(Instant(since)),
            },
            unheard: words[field::UNHEARD],
            missed_deadlines: words[field::MISSED_DEADLINES],
            lost_liveliness: words[field::LOST_LIVELINESS],
            away: words[field::AWAY],
            held: words[field::HELD],
            max_held: words[field::MAX_HELD],
            created: Instant(words[field::CREATED]),
            recent_ns,
        })
    }

    /// The fields of this entry, with that [`TURN`](field::TURN).
    #[must_use]
    //= SM2-CNT-005
    pub fn to_words(&self, turn: u64) -> [u64; ENTRY_FIELDS] {
        let mut words = [0; ENTRY_FIELDS];
        words[field::TURN] = turn;
        words[field::KIND] = KIND_INTERFACE;
        words[field::INTERFACE] = self.interface.0;
        if let Some(link) = self.link {
            words[field::KIND] = KIND_LINK;
            words[field::LINK_EPOCH] = link.epoch;
            words[field::LINK_SERIAL] = link.serial;
        }
        words[field::MESSAGES] = self.messages;
        words[field::BYTES] = self.bytes;
        words[field::LAST] = self.last.0;
        words[field::LOST] = self.lost;
        words[field::OFFERED] = self.fates.offered;
        words[field::IN_FLIGHT] = self.fates.in_flight;
        for fate in Fate::ALL {
            words[fate.position()] = self.fates.of(fate);
        }
        words[field::DELAY_SUM] = self.delay_sum_ns;
        words[field::DELAY_MAX] = self.delay_max_ns;
        words[field::SHORT_SINCE] = self.short_since.map_or(0, |since| since.0);
        words[field::UNHEARD] = self.unheard;
        words[field::MISSED_DEADLINES] = self.missed_deadlines;
        words[field::LOST_LIVELINESS] = self.lost_liveliness;
        words[field::AWAY] = self.away;
        words[field::HELD] = self.held;
        words[field::MAX_HELD] = self.max_held;
        words[field::CREATED] = self.created.0;
        words[field::RECENT..].copy_from_slice(&self.recent_ns);
        words
    }

    /// The notes of at most [`RECENT`] last messages, the oldest first: times of publication on a
    /// sending side, delays on a receiving side.
    //= SM2-CNT-005
    pub fn recent(&self) -> impl ExactSizeIterator<Item = u64> + Clone + '_ {
        let noted = self.messages.min(RECENT as u64);
        let oldest = self.messages - noted;
        (0..noted as usize).map(move |n| self.recent_ns[recent_index(oldest + n as u64 + 1)])
    }

    /// The times between the last messages of a sending side; `None` with less than two messages. A
    /// negative gap counts as zero.
    #[must_use]
    pub fn gaps(&self) -> Option<Summary> {
        let next = self.recent().skip(1);
        Summary::of(self.recent().zip(next).map(|(a, b)| b.saturating_sub(a)))
    }

    /// The delays of the last messages of a receiving side; `None` without any.
    #[must_use]
    pub fn recent_delays(&self) -> Option<Summary> {
        Summary::of(self.recent())
    }

    /// The mean delay of all messages of a receiving side; `None` without any.
    #[must_use]
    pub const fn mean_delay_ns(&self) -> Option<u64> {
        self.delay_sum_ns.checked_div(self.messages)
    }

    /// The rates between an earlier copy of the same entry and this one, which was made `elapsed`
    /// later. `None` if no time has passed, or if the entry counts something else: its ids differ,
    /// or a count is less than before.
    #[must_use]
    pub fn rate_since(&self, earlier: &Self, elapsed: Duration) -> Option<Rate> {
        let same = (self.interface, self.link) == (earlier.interface, earlier.link);
        if !same || elapsed.is_zero() {
            return None;
        }
        let messages = self.messages.checked_sub(earlier.messages)?;
        let bytes = self.bytes.checked_sub(earlier.bytes)?;
        let seconds = elapsed.as_secs_f64();
        Some(Rate {
            messages_per_s: messages as f64 / seconds,
            bytes_per_s: bytes as f64 / seconds,
        })
    }
}

/// The rates of growth of counters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Messages per second.
    pub messages_per_s: f64,
    /// Bytes per second.
    pub bytes_per_s: f64,
}

/// A summary of durations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// The number of durations, at least one.
    pub count: u32,
    /// Their mean, rounded down.
    pub mean_ns: u64,
    /// The shortest duration.
    pub min_ns: u64,
    /// The longest duration.
    pub max_ns: u64,
    /// The standard deviation of just these durations, rounded down.
    pub std_dev_ns: u64,
}

impl Summary {
    /// The summary of at most 2^32 durations in nanoseconds; `None` if there are none.
    #[must_use]
    pub fn of(durations: impl Iterator<Item = u64> + Clone) -> Option<Self> {
        let mut count = 0_u32;
        let (mut sum, mut min_ns, mut max_ns) = (0_u128, u64::MAX, 0);
        for duration in durations.clone() {
            count += 1;
            sum += u128::from(duration);
            min_ns = min_ns.min(duration);
            max_ns = max_ns.max(duration);
        }
        // Never more than the largest duration, so it fits.
        let mean_ns = sum.checked_div(u128::from(count))? as u64;
        // For 32 durations it saturates only where they deviate by more than 2^61 ns (70 years).
        let squares = durations.fold(0_u128, |sum, duration| {
            let off = u128::from(duration.abs_diff(mean_ns));
            sum.saturating_add(off * off)
        });
        let variance = squares / u128::from(count);
        Some(Self {
            count,
            mean_ns,
            min_ns,
            max_ns,
            std_dev_ns: variance.isqrt() as u64,
        })
    }

    /// Messages per second, if these are the times between messages; `None` if no time passed
    /// between them.
    #[must_use]
    pub fn per_second(&self) -> Option<f64> {
        (self.mean_ns > 0).then(|| 1e9 / self.mean_ns as f64)
    }
}
