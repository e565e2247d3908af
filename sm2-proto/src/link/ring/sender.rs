//! The sender's side of a ring: the words that it put, and the messages that are not settled.

#[cfg(any(kani, test))]
mod proofs;
mod segments;

use alloc::{vec, vec::Vec};

use self::segments::{SenderSegments, Unsettled};
use super::{
    super::{Counters, Fate, Misuse, debt::Debt, frame_kind::Carrier},
    At, CellMessage, CellWord, EMPTY, RingLayout, RingMemory, Wake, Word,
    message::{RingMessage, RingSendError},
    wake_parked,
};
use crate::{Violation, limits::RING_DISPLACED_MAX};

/// How many messages ahead a cell is prefetched.
const PREFETCHED: u64 = 4;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingSender {
    layout: RingLayout,
    carrier: Carrier,
    /// Whether a message that was not taken is displaced by the message one round later.
    displaces: bool,
    /// Whether messages have a lifespan, so that the receiver can give them back as expired.
    expires: bool,
    /// The sequence number of the last message.
    sequence: u64,
    /// The word that this side last put at each index; [`EMPTY`] if it put none, took the word out itself, or knows
    /// that the receiver took it.
    forward: Vec<u64>,
    /// How many messages in cells are not settled.
    in_cells: u32,
    /// All messages in cells up to this sequence number are settled. They are settled in order: the receiver takes them
    /// in order, and the oldest one is displaced.
    cells_settled: u64,
    /// How many messages the receiver gave back.
    returned: u64,
    /// How many messages are not settled.
    unreleased: u32,
    pub(in crate::link) segments: SenderSegments,
    last_id: Option<u64>,
    /// How many messages were displaced since the receiver last took one.
    displaced: u32,
    /// By sequence numbers.
    debt: Debt,
    /// Its `in_flight` is always zero: [`Self::counters`] computes the true value.
    counters: Counters,
}

impl RingSender {
    pub(in crate::link) fn new(
        layout: RingLayout,
        carrier: Carrier,
        reliable: bool,
        expires: bool,
    ) -> Self {
        Self {
            layout,
            carrier,
            displaces: !reliable,
            expires,
            sequence: 0,
            forward: vec![EMPTY; usize::from(layout.depth())],
            in_cells: 0,
            cells_settled: 0,
            returned: 0,
            unreleased: 0,
            segments: SenderSegments::default(),
            last_id: None,
            displaced: 0,
            debt: Debt::default(),
            counters: Counters::default(),
        }
    }

    /// Whether one more message could be sent without displacing another and without being refused.
    #[inline]
    pub(in crate::link) fn has_room(&self, words: &impl RingMemory) -> bool {
        // A receiver takes messages in order, before it gives them back. So if fewer are unreleased than the ring has
        // words, it has taken the one in the next word, and the line of that word, which it writes, stays with it.
        self.unreleased < u32::from(self.layout.depth())
            || self.unreleased < self.layout.window()
                && words.load(self.layout.forward(self.sequence + 1)) == EMPTY
    }

    /// Puts a message into the ring. Returns whether the receiver has to be woken.
    //= SM2-RNG-005, SM2-RNG-010
    pub(in crate::link) fn send(
        &mut self,
        words: &impl RingMemory,
        message: &RingMessage,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, RingSendError> {
        let sequence = self.sequence + 1;
        self.check_id(message.id)?;
        let word = self.segments.check(message, sequence)?;
        if !self.displaces && !self.has_room(words) {
            return Err(Misuse::NoRoom.into());
        }
        let at = self.layout.forward(sequence);
        let room = self.make_room(words, at, settled);
        // From here on the message is settled like any other, whatever the receiver does.
        self.enter(message.id, sequence);
        self.segments.enter(message, sequence);
        room?;
        self.put(words, at, word.to_bits(), settled)?;
        self.end_send(words)
    }

    /// Puts a short message into its cell. Returns whether the receiver has to be woken.
    //= SM2-RNG-005, SM2-RNG-010, SM2-RNG-013
    pub(in crate::link) fn send_in_cell(
        &mut self,
        words: &impl RingMemory,
        message: &CellMessage<'_>,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<Wake, RingSendError> {
        let sequence = self.sequence + 1;
        if self.expires {
            return Err(Misuse::NotPooled.into());
        }
        self.check_id(message.id)?;
        let word = CellWord::new(message.bytes.len(), message.status, sequence);
        let word = word.ok_or(Misuse::TooLong)?;
        if !self.displaces && !self.has_room(words) {
            return Err(Misuse::NoRoom.into());
        }
        let at = self.layout.forward(sequence);
        let room = self.make_room(words, at, settled);
        let room = room.and_then(|()| self.clear(words, at, settled));
        // From here on the message is settled like any other, whatever the receiver does.
        self.enter(message.id, sequence);
        self.in_cells += 1;
        room?;
        if let (At::Forward(index), Some(cell)) = (at, message.to_words().get(..word.words())) {
            words.write_cell(index, cell);
        }
        if words.swap(at, word.to_bits()) != EMPTY {
            return Err(violation!(BadWord, "SM2-RNG-005").into());
        }
        self.replace(at, word.to_bits());
        let wake = self.end_send(words)?;
        self.look_ahead(words);
        Ok(wake)
    }

    /// Reads the next word now if the next call would have to: nobody waits meanwhile for its line, which the receiver
    /// has written.
    #[inline]
    fn look_ahead(&mut self, words: &impl RingMemory) {
        let next = self.layout.forward(self.sequence + 1);
        if self.unreleased >= u32::from(self.layout.depth())
            && !self.is_settled_at(next)
            && words.load(next) == EMPTY
        {
            self.note_taken(next);
        }
        // The receiver watches the next cell, but not those after it.
        if u64::from(self.layout.depth()) > 2 * PREFETCHED {
            words.prefetch(self.layout.forward(self.sequence + PREFETCHED));
        }
    }

    /// Ends a call that has put a message.
    //= SM2-RNG-010, SM2-RNG-012
    #[inline]
    fn end_send(&self, words: &impl RingMemory) -> Result<Wake, RingSendError> {
        if self.displaced >= RING_DISPLACED_MAX {
            return Err(RingSendError::Stopped);
        }
        Ok(wake_parked(words, At::ReceiverParked))
    }

    /// Empties the cell at an index before it is written: the receiver may still copy a message that is in it.
    //= SM2-RNG-013
    #[inline]
    fn clear(
        &mut self,
        words: &impl RingMemory,
        at: At,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<(), Violation> {
        if self.is_settled_at(at) || words.load(at) == EMPTY {
            // The receiver has taken the message, if there was one.
            self.note_taken(at);
            return Ok(());
        }
        self.put(words, at, EMPTY, settled)
    }

    /// Whether this side knows that the word at this index is empty.
    #[inline]
    fn is_settled_at(&self, at: At) -> bool {
        let At::Forward(index) = at else {
            return false;
        };
        match self.forward.get(index as usize) {
            Some(&EMPTY) => true,
            Some(&bits) => CellWord::from_bits(bits)
                .is_some_and(|cell| self.sequence_of(cell) <= Some(self.cells_settled)),
            None => false,
        }
    }

    /// The sequence number of a message in the ring.
    #[inline]
    const fn sequence_of(&self, cell: CellWord) -> Option<u64> {
        // The last `depth` numbers differ in their low halves.
        let ago = (self.sequence as u32).wrapping_sub(cell.sequence);
        self.sequence.checked_sub(ago as u64)
    }

    /// The word at this index is empty: the receiver has taken the message that this side put there.
    #[inline]
    fn note_taken(&mut self, at: At) {
        let before = self.replace(at, EMPTY);
        // If this side took the word out itself, the empty word does not show that the receiver took a message.
        if before != EMPTY {
            self.displaced = 0;
        }
        if let Some(cell) = CellWord::from_bits(before) {
            // Otherwise it is settled already.
            let _ = self.settle_cell(cell, Fate::Delivered);
        }
    }

    /// Notes the word that this side puts at an index. Returns the one before.
    #[inline]
    fn replace(&mut self, at: At, bits: u64) -> u64 {
        match at {
            At::Forward(index) => match self.forward.get_mut(index as usize) {
                Some(ours) => core::mem::replace(ours, bits),
                None => EMPTY,
            },
            _ => EMPTY,
        }
    }

    /// Settles a message in a cell. `None` if it is settled.
    #[inline]
    fn settle_cell(&mut self, cell: CellWord, fate: Fate) -> Option<()> {
        let sequence = self.sequence_of(cell)?;
        if sequence <= self.cells_settled {
            return None;
        }
        self.cells_settled = sequence;
        self.debt.settle(sequence);
        self.in_cells -= 1;
        self.unreleased -= 1;
        *self.counters.of_mut(fate) += 1;
        Some(())
    }

    /// If the window is full, takes the oldest message out of the ring and settles the messages
    /// that came back.
    //= SM2-RNG-006
    fn make_room(
        &mut self,
        words: &impl RingMemory,
        at: At,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<(), Violation> {
        if self.unreleased < self.layout.window() {
            return Ok(());
        }
        self.put(words, at, EMPTY, settled)?;
        self.harvest(words, settled)?;
        if self.unreleased >= self.layout.window() {
            return Err(violation!(WindowExceeded, "SM2-RNG-006"));
        }
        Ok(())
    }

    /// Records a message that may be sent.
    #[inline]
    const fn enter(&mut self, id: u64, sequence: u64) {
        self.sequence = sequence;
        self.last_id = Some(id);
        self.counters.offered += 1;
        self.unreleased += 1;
    }

    #[inline]
    fn check_id(&self, id: u64) -> Result<(), Misuse> {
        if self.carrier != Carrier::Reply && id <= self.last_id.unwrap_or(0) {
            return Err(Misuse::IdNotGrowing);
        }
        Ok(())
    }

    /// Puts a word at an index and settles the message that it displaced.
    //= SM2-RNG-005, SM2-QOS-001
    fn put(
        &mut self,
        words: &impl RingMemory,
        at: At,
        bits: u64,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<(), Violation> {
        let was = words.swap(at, bits);
        if was == EMPTY {
            self.note_taken(at);
            self.replace(at, bits);
            return Ok(());
        }
        let put = self.replace(at, bits);
        if was != put || !self.displaces {
            return Err(violation!(BadWord, "SM2-RNG-005"));
        }
        self.displaced = self.displaced.saturating_add(1);
        if let Some(cell) = CellWord::from_bits(put) {
            let displaced = self.settle_cell(cell, Fate::Discarded);
            return displaced.ok_or(violation!(BadWord, "SM2-RNG-005"));
        }
        // `settle` fails if this message was already given back, so no message is counted twice.
        let displaced = self.settle(put);
        let (key, _) = displaced.ok_or(violation!(BadWord, "SM2-RNG-005"))?;
        self.counters.discarded += 1;
        settled(key, Fate::Discarded);
        Ok(())
    }

    /// Settles the messages that the receiver gave back.
    //= SM2-RNG-008
    pub(in crate::link) fn harvest(
        &mut self,
        words: &impl RingMemory,
        settled: &mut impl FnMut(u64, Fate),
    ) -> Result<(), Violation> {
        for _ in 0..self.layout.window() {
            let at = self.layout.back_word(self.returned);
            if words.load(at) == EMPTY {
                break;
            }
            let bits = words.swap(at, EMPTY);
            self.returned += 1;
            let back = self.settle(bits);
            let (key, fate) = back.ok_or(violation!(BadWord, "SM2-RNG-008"))?;
            *self.counters.of_mut(fate) += 1;
            settled(key, fate);
        }
        self.harvest_cells(words);
        Ok(())
    }

    /// Settles the messages in cells that the receiver has taken.
    //= SM2-RNG-013
    fn harvest_cells(&mut self, words: &impl RingMemory) {
        if self.in_cells == 0 {
            return;
        }
        let is_taken = |words: &_, at| RingMemory::load(words, at) == EMPTY;
        // The receiver takes messages in order, so often one look suffices.
        if is_taken(words, self.layout.forward(self.sequence)) && !self.debt.is_owed() {
            self.counters.delivered += u64::from(self.in_cells);
            self.unreleased -= self.in_cells;
            self.in_cells = 0;
            self.cells_settled = self.sequence;
            self.displaced = 0;
            return;
        }
        let depth = u64::from(self.layout.depth());
        let oldest = self.sequence.saturating_sub(depth).max(self.cells_settled) + 1;
        for sequence in oldest..=self.sequence {
            let at = self.layout.forward(sequence);
            if !is_taken(words, at) {
                break;
            }
            self.note_taken(at);
        }
    }

    /// Settles the message that these bits name, and returns its key and whether it was delivered or
    /// has expired. `None` if they name no unsettled message.
    //= SM2-RNG-008
    #[inline]
    fn settle(&mut self, bits: u64) -> Option<(u64, Fate)> {
        let word = Word::from_bits(bits).ok()??;
        let expires = self.expires;
        let settled = (self.segments).settle(word, |Unsettled { key, sequence }| {
            let sequence = sequence.get();
            let fate = if sequence as u32 == word.sequence {
                Fate::Delivered
            } else if expires && sequence as u32 == !word.sequence {
                Fate::Expired
            } else {
                return None;
            };
            Some((key, sequence, fate))
        });
        let (key, sequence, fate) = settled?;
        self.unreleased -= 1;
        self.debt.settle(sequence);
        Some((key, fate))
    }

    /// Counts a publication that is not sent on this link.
    //= SM2-QOS-008, SM2-QOS-010, SM2-QOS-002, SM2-QOS-003, SM2-QOS-007
    pub(in crate::link) const fn drop_publication(&mut self, fate: Fate) {
        self.counters.drop_publication(fate);
        if fate.incurs_debt() {
            self.debt.incur(self.sequence, self.unreleased as u64);
        }
    }

    /// Counts a queued message that is not sent, because the link is over.
    //= SM2-OPN-009
    pub(super) const fn count_closed(&mut self) {
        self.counters.drop_publication(Fate::Closed);
    }

    /// Ends the sender's side with the link. Passes the keys of all messages that were not settled
    /// to `each`.
    //= SM2-OPN-009
    pub(in crate::link) fn end(&mut self, mut each: impl FnMut(u64)) {
        self.segments.keys().for_each(&mut each);
        self.segments.clear();
        self.counters.closed += u64::from(self.unreleased);
        self.unreleased = 0;
        self.in_cells = 0;
        self.debt.clear();
    }

    #[inline]
    pub(in crate::link) const fn owes(&self) -> bool {
        self.debt.is_owed()
    }

    /// The keys of the messages that are not settled.
    pub(in crate::link) fn keys(&self) -> impl Iterator<Item = u64> {
        (self.segments.keys()).take((self.unreleased - self.in_cells) as usize)
    }

    pub(in crate::link) const fn in_flight(&self) -> usize {
        self.unreleased as usize
    }

    //= SM2-QOS-006
    #[inline]
    pub(in crate::link) fn counters(&self) -> Counters {
        Counters {
            in_flight: u64::from(self.unreleased),
            ..self.counters
        }
    }

    /// Checks the invariants, which hold after each call.
    #[inline]
    pub(in crate::link) fn invariants(&self) {
        if cfg!(debug_assertions) {
            let it = self.counters();
            debug_assert!(it.is_balanced(), "{it:?}");
            debug_assert!(self.debt.left() <= it.in_flight);
            let in_slots = self.segments.invariants();
            debug_assert_eq!(in_slots + self.in_cells, self.unreleased);
            debug_assert!(self.unreleased <= self.layout.window());
        }
    }
}
