//! The fates of messages, and their counts. Each fate is one row of a table, which gives it one name everywhere. Each
//! sum over the fates is here.

use core::fmt;

/// Whether a driver can say of a publication that it was not sent on a link, and then ended like this. `Owed`: the link
/// also owes from then on.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Unsent {
    No,
    Yes,
    //= SM2-QOS-003
    Owed,
}

/// Defines [`Fate`] and [`Counters`] from the table of the fates.
macro_rules! fates {
    ($($fate:ident $count:ident $position:literal $unsent:ident $meaning:literal)*) => {
        /// How a message of a link ended.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Fate {
            $(
                #[doc = concat!("`", stringify!($count), "`: ", $meaning, ".")]
                $fate,
            )*
        }

        impl Fate {
            /// All fates, in the order in which they are shown.
            pub const ALL: [Self; [$(Self::$fate,)*].len()] = [$(Self::$fate,)*];

            /// The name in SPEC, in counters and in JSON.
            //= SM2-QOS-006
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self {
                    $(Self::$fate => stringify!($count),)*
                }
            }

            /// The position of its number in an entry of a counters' file.
            //= SM2-CNT-005
            #[must_use]
            #[inline]
            pub const fn position(self) -> usize {
                match self {
                    $(Self::$fate => $position,)*
                }
            }

            /// The text that says what became of the message, to follow its name.
            #[must_use]
            pub const fn meaning(self) -> &'static str {
                match self {
                    $(Self::$fate => $meaning,)*
                }
            }

            const fn unsent(self) -> Unsent {
                match self {
                    $(Self::$fate => Unsent::$unsent,)*
                }
            }
        }

        /// Counts of all messages of one link, by fate. The messages offered are those of all fates and those in
        /// flight: [`is_balanced`](Self::is_balanced).
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        pub struct Counters {
            /// Every message that was passed to [`send`](super::Link::send), and every publication that was
            /// [dropped](super::Input::Drop).
            pub offered: u64,
            $(
                #[doc = concat!("See [`Fate::", stringify!($fate), "`].")]
                pub $count: u64,
            )*
            /// Queued on this side, or sent and not yet released.
            pub in_flight: u64,
        }

        impl Counters {
            /// The number of messages with this fate.
            #[must_use]
            #[inline]
            pub const fn of(&self, fate: Fate) -> u64 {
                match fate {
                    $(Fate::$fate => self.$count,)*
                }
            }

            /// The number of messages with this fate, to change it.
            #[inline]
            pub const fn of_mut(&mut self, fate: Fate) -> &mut u64 {
                match fate {
                    $(Fate::$fate => &mut self.$count,)*
                }
            }
        }
    };
}

// The fate, its name and field, its position in an entry, whether a driver can say so of a publication that it does not
// send, and what it means.
fates! {
    Delivered delivered 10 No "released as consumed: the application took it"
    Overwritten overwritten 11 Yes "displaced before it was sent, or not sent for lack of a slot or of room"
    Discarded discarded 12 No "displaced by a later message on the other side"
    NoRoom no_room 13 Owed "not sent, because a reliable subscriber had no room in time, or its link owed"
    Closed closed 14 No "not settled when the link ended"
    PoolLimit pool_limit 18 Owed "not sent, because the subscriber holds too much of the publisher's memory"
    // When it was queued, that may not have been known: OPEN came later.
    TooLong too_long 19 Yes "longer than the other end accepts"
    Expired expired 23 Yes "older than its lifespan before it was sent, or before the application took it"
}

impl Fate {
    /// Whether a message with this fate did not reach the application.
    #[must_use]
    #[inline]
    pub const fn is_drop(self) -> bool {
        !matches!(self, Self::Delivered)
    }

    /// Whether a driver can say so of a publication that it does not send on a link.
    #[must_use]
    pub const fn is_unsent(self) -> bool {
        !matches!(self.unsent(), Unsent::No)
    }

    /// Whether the link of a publication that was not sent owes from then on.
    //= SM2-QOS-003
    pub(super) const fn incurs_debt(self) -> bool {
        matches!(self.unsent(), Unsent::Owed)
    }
}

impl fmt::Display for Fate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl Counters {
    /// The messages that were dropped, for any reason.
    #[must_use]
    #[inline]
    pub fn dropped(&self) -> u64 {
        let drops = Fate::ALL.into_iter().filter(|it| it.is_drop());
        drops.fold(0, |sum, fate| sum.saturating_add(self.of(fate)))
    }

    /// Whether each message that was offered has one fate or is in flight.
    //= SM2-QOS-006
    #[must_use]
    pub fn is_balanced(&self) -> bool {
        let settled = self.delivered.saturating_add(self.dropped());
        self.offered == settled.saturating_add(self.in_flight)
    }

    /// Adds the counts of another link.
    pub fn add(&mut self, other: &Self) {
        self.offered += other.offered;
        self.in_flight += other.in_flight;
        for fate in Fate::ALL {
            *self.of_mut(fate) += other.of(fate);
        }
    }

    /// Counts a publication that is not sent.
    pub(super) const fn drop_publication(&mut self, fate: Fate) {
        self.offered += 1;
        *self.of_mut(fate) += 1;
    }
}
