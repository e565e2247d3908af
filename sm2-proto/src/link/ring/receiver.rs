//! The receiver's side of a ring: the message that it expects, and the messages that the
//! application holds.

mod borrowed;
#[cfg(any(kani, test))]
mod proofs;

use self::borrowed::Borrowed;
use super::{
    super::{
        Delivery, MaxLen, Misuse, Payload, SlotRange, Status, TooManyBorrowed, frame_kind::Carrier,
        segments::Geometry, wire::Given,
    },
    At, CELL_WORDS, CellView, CellWord, EMPTY, RingLayout, RingMemory, SlotHead, Wake, Word,
    wake_parked,
};
use crate::{
    Instant, Newest, Violation,
    limits::{MESSAGE_MAX, RING_DISPLACED_MAX, SLOT_HEAD},
};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingReceiver {
    layout: RingLayout,
    carrier: Carrier,
    /// Whether the sender may displace messages that were not taken.
    displaces: bool,
    /// Whether the sender may put messages into cells.
    cells: bool,
    /// Whether a message came in a cell. The sender settles such messages when they are taken, and may wait for that.
    pub(in crate::link) took_cell: bool,
    max_borrowed: u16,
    /// The length of the longest message that this end accepts, in bytes.
    max_len: u64,
    /// The sequence number of the expected message.
    next: u64,
    /// The id of the last message that was taken.
    last_id: Option<u64>,
    /// The time of the last message that was taken.
    last_time: Option<Instant>,
    /// How many messages the application gave back.
    given: u64,
    borrowed: Borrowed,
    /// How many messages can still be taken after the end of the link; `None` before the end.
    left: Option<u16>,
}

/// A word that was taken out of the ring, and the slot that it names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) struct TakenWord {
    word: Word,
    pub(in crate::link) slot: SlotRange,
}

/// The reason why no message is taken although the ring is not empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) enum NotTaken {
    TooManyBorrowed(TooManyBorrowed),
    /// The segment is not attached. The socket may have the datagram that attaches it.
    UnknownSegment,
    Violation(Violation),
}

/// A message that was taken out of the ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) enum TakenMessage {
    /// Its head is in the slot that the word names.
    Slot(TakenWord),
    /// The message is in the copy of its cell.
    Cell(CellWord),
}

/// The reason why a message was not given back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) enum NotReleased {
    Misuse(Misuse),
    Violation(Violation),
}

impl From<Misuse> for NotReleased {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl From<Violation> for NotTaken {
    fn from(violation: Violation) -> Self {
        Self::Violation(violation)
    }
}

impl Word {
    /// The slot that the word names in a segment of this geometry; `None` if there is none.
    #[inline]
    fn place(self, geometry: Geometry) -> Option<SlotRange> {
        Some(SlotRange {
            segment: self.segment.into(),
            offset: geometry.offset(self.slot.into())?,
            stride: geometry.stride(),
        })
    }
}

impl RingReceiver {
    pub(in crate::link) fn new(
        layout: RingLayout,
        carrier: Carrier,
        reliable: bool,
        expires: bool,
        max_borrowed: u16,
        max_len: MaxLen,
    ) -> Self {
        Self {
            layout,
            carrier,
            displaces: !reliable,
            cells: !expires,
            took_cell: false,
            max_borrowed,
            max_len: max_len.bytes(),
            next: 1,
            last_id: None,
            last_time: None,
            given: 0,
            borrowed: Borrowed::with_capacity(max_borrowed),
            left: None,
        }
    }

    #[inline]
    pub(in crate::link) const fn layout(&self) -> RingLayout {
        self.layout
    }

    /// The word that the next message fills; `None` after the end of the link.
    #[inline]
    pub(in crate::link) const fn next_word(&self) -> Option<At> {
        match self.left {
            None => Some(self.layout.forward(self.next)),
            Some(_) => None,
        }
    }

    /// Whether there is a message, or an invalid word.
    pub(in crate::link) fn may_take(&self, words: &impl RingMemory) -> bool {
        self.left != Some(0) && words.load(self.layout.forward(self.oldest(words))) != EMPTY
    }

    /// The sequence number of the oldest message in the ring. A sender that died while it made room
    /// left an empty word at the index of its oldest message; the messages after it are still in
    /// the ring.
    //= SM2-RNG-010
    #[inline]
    fn oldest(&self, words: &impl RingMemory) -> u64 {
        if self.left.is_none() || !self.displaces {
            return self.next;
        }
        let last = self.next.saturating_add(u64::from(self.layout.depth()));
        let is_there = |it: &u64| words.load(self.layout.forward(*it)) != EMPTY;
        let oldest = || (self.next..last).find(is_there);
        // Searches twice: a load that sees a word also acquires all words that were put before it,
        // so only the second search is sure to see an older word.
        oldest().and_then(|_| oldest()).unwrap_or(self.next)
    }

    /// How many words are not empty.
    pub(in crate::link) fn untaken(&self, words: &impl RingMemory) -> usize {
        if self.left == Some(0) {
            return 0;
        }
        let depth = u32::from(self.layout.depth());
        let words = (0..depth).filter(|index| words.load(At::Forward(*index)) != EMPTY);
        words.count()
    }

    /// The newest message: the newest one in the ring, or else the last one that was taken.
    pub(in crate::link) fn newest(&self, words: &impl RingMemory) -> Newest {
        let depth = u32::from(self.layout.depth());
        let sequences = (0..depth).filter_map(|it| sequence_of(words.load(At::Forward(it))));
        let ahead = sequences.map(|it| it.wrapping_sub(self.next as u32)).max();
        match ahead {
            Some(ahead) => Newest {
                sequence: self.next.saturating_add(u64::from(ahead)),
                time: None,
            },
            None => Newest {
                sequence: self.next - 1,
                time: self.last_time,
            },
        }
    }

    /// Takes the word of the next message out of the ring. For a message in a cell, `cell` has a copy then, which the
    /// caller passes to [`receive_cell`](Self::receive_cell). For another one it copies the head from the end of its
    /// slot, and passes both to [`receive`](Self::receive).
    //= SM2-RNG-007, SM2-RNG-013, SM2-MSG-005
    #[inline]
    pub(in crate::link) fn take_word(
        &mut self,
        words: &impl RingMemory,
        cell: &mut [u64; CELL_WORDS],
        geometry: impl Fn(u32) -> Option<Geometry>,
        prefetch: impl Fn(SlotRange),
    ) -> Result<Option<TakenMessage>, NotTaken> {
        if self.left == Some(0) {
            return Ok(None);
        }
        self.next = self.oldest(words);
        // Each iteration except the last either shows that the sender has put more messages
        // meanwhile, or brings `next` one message closer to the messages that the sender left.
        for _ in 0..2 * u32::from(self.layout.depth()) {
            let at = self.layout.forward(self.next);
            let bits = words.load(at);
            if let Some(word) = CellWord::from_bits(bits) {
                if !self.cells {
                    return Err(violation!(BadWord, "SM2-RNG-013").into());
                }
                if self.is_expected(word.sequence)? {
                    copy_cell(words, at, word, cell);
                    if words.take(at, bits) {
                        return Ok(Some(TakenMessage::Cell(word)));
                    }
                }
                continue;
            }
            let word = Word::from_bits(bits);
            let word = word.map_err(|_| violation!(BadWord, "SM2-RNG-007"))?;
            let Some(word) = word else {
                return Ok(None);
            };
            if !self.is_expected(word.sequence)? {
                continue;
            }
            if self.borrowed.len() >= usize::from(self.max_borrowed) {
                return Err(NotTaken::TooManyBorrowed(TooManyBorrowed {
                    max_borrowed: self.max_borrowed,
                }));
            }
            let segment = geometry(word.segment.into()).ok_or(NotTaken::UnknownSegment)?;
            let slot = word.place(segment);
            let slot = slot.ok_or(violation!(BadSlot, "SM2-RNG-007"))?;
            prefetch(slot);
            if words.take(at, bits) {
                return Ok(Some(TakenMessage::Slot(TakenWord { word, slot })));
            }
        }
        Ok(None)
    }

    /// Prefetches the message that is `ahead` of the expected one, if it is there already: its transfer from the
    /// sender's core overlaps what happens before it is taken. The word is a hint here: it is checked when it is
    /// taken.
    #[inline]
    pub(in crate::link) fn prefetch(
        &self,
        words: &impl RingMemory,
        ahead: u64,
        geometry: impl Fn(u32) -> Option<Geometry>,
        prefetch: impl Fn(SlotRange),
    ) {
        let at = self.layout.forward(self.next.wrapping_add(ahead));
        let bits = words.load(at);
        if CellWord::from_bits(bits).is_some() {
            words.prefetch(at);
        } else if let Ok(Some(word)) = Word::from_bits(bits)
            && let Some(segment) = geometry(word.segment.into())
            && let Some(slot) = word.place(segment)
        {
            prefetch(slot);
        }
    }

    /// Whether this word names the expected message. If the sender has displaced messages, this
    /// function sets `next` to the message that is now expected.
    //= SM2-RNG-007
    #[inline]
    fn is_expected(&mut self, sequence: u32) -> Result<bool, Violation> {
        let ahead = u64::from(sequence.wrapping_sub(self.next as u32));
        if ahead == 0 {
            return Ok(true);
        }
        let depth = u64::from(self.layout.depth());
        // A distance greater than a legal sender can reach means that the word is older than
        // expected.
        let is_later = ahead.is_multiple_of(depth) && ahead < u64::from(RING_DISPLACED_MAX) + depth;
        if !self.displaces || !is_later {
            return Err(violation!(BadWord, "SM2-RNG-007"));
        }
        let next = self.next.checked_add(ahead - (depth - 1));
        self.next = next.ok_or(violation!(BadWord, "SM2-RNG-007"))?;
        Ok(false)
    }

    /// Handles a message that was taken out of its cell: checks its head, and delivers it.
    //= SM2-RNG-013, SM2-MSG-002
    #[inline]
    pub(in crate::link) fn receive_cell<'a>(
        &mut self,
        word: CellWord,
        cell: &'a [u64; CELL_WORDS],
    ) -> Result<Delivery<CellView<'a>>, NotTaken> {
        let [id, time, payload @ ..] = cell;
        let len = u64::from(word.len);
        let sequence = self.advance()?;
        self.took_cell = true;
        if self.carrier != Carrier::Reply && word.status != Status::Ok {
            return Err(violation!(ReservedNotZero, "SM2-RNG-013").into());
        }
        let lost = self.lost_before(*id, sequence);
        let lost = lost.ok_or(violation!(BadId, "SM2-RNG-013"))?;
        // The smallest limit of a receiver is greater.
        debug_assert!(len <= self.max_len);
        self.note_delivered(*id, Instant(*time));
        Ok(Delivery {
            sequence,
            id: *id,
            time: Instant(*time),
            status: word.status,
            lost,
            len,
            payload: Payload::Cell(CellView::new(payload, word.len)),
        })
    }

    /// Expects the next message. Returns the sequence number of the one that was taken.
    #[inline]
    fn advance(&mut self) -> Result<u64, Violation> {
        let sequence = self.next;
        let next = sequence.checked_add(1);
        self.next = next.ok_or(violation!(BadWord, "SM2-RNG-007"))?;
        Ok(sequence)
    }

    /// How many messages were lost before the one that was taken; `None` if its id does not grow.
    //= SM2-MSG-002, SM2-SRV-001
    #[inline]
    fn lost_before(&self, id: u64, sequence: u64) -> Option<u64> {
        if self.carrier != Carrier::Reply && id <= self.last_id.unwrap_or(0) {
            return None;
        }
        Some(match (self.carrier, self.last_id) {
            (Carrier::Data, Some(last)) => id - last - 1,
            // Every message that was displaced before the first one had a sequence number.
            (Carrier::Data, None) => sequence - 1,
            (Carrier::Request | Carrier::Reply, _) => 0,
        })
    }

    #[inline]
    const fn note_delivered(&mut self, id: u64, time: Instant) {
        self.last_id = Some(id);
        self.last_time = Some(time);
        if let Some(left) = &mut self.left {
            *left -= 1;
        }
    }

    /// Handles a word that was taken out of the ring: checks the head of its message and delivers
    /// it.
    //= SM2-RNG-004, SM2-PAY-005, SM2-PAY-006, SM2-PAY-008, SM2-PAY-010, SM2-MSG-002, SM2-SRV-001
    #[inline]
    pub(in crate::link) fn receive<C>(
        &mut self,
        TakenWord { word, slot }: TakenWord,
        head: Option<[u8; SLOT_HEAD]>,
    ) -> Result<Delivery<C>, NotTaken> {
        let sequence = self.advance()?;
        if self.borrowed.is_at(word) {
            return Err(violation!(SlotBusy, "SM2-RNG-007").into());
        }
        let head = SlotHead::from_bytes(&head.ok_or(NotTaken::UnknownSegment)?, self.carrier)?;
        let lost = self.lost_before(head.id, sequence);
        let lost = lost.ok_or(violation!(BadId, "SM2-RNG-004"))?;
        // `max_len` is at most `MESSAGE_MAX`.
        if head.len > self.max_len || head.len > slot.stride - SLOT_HEAD as u64 {
            return Err(self.illegal_len(head.len, slot).into());
        }
        self.borrowed.push(sequence, word);
        self.note_delivered(head.id, head.time);
        Ok(Delivery {
            sequence,
            id: head.id,
            time: head.time,
            status: head.status,
            lost,
            len: head.len,
            payload: Payload::Pooled {
                segment: slot.segment,
                offset: slot.offset,
            },
        })
    }

    /// The violation of a message with an illegal length.
    //= SM2-RNG-004, SM2-PAY-008, SM2-PAY-010
    #[cold]
    fn illegal_len(&self, len: u64, slot: SlotRange) -> Violation {
        if len > MESSAGE_MAX || len > slot.stride - SLOT_HEAD as u64 {
            return violation!(BadLength, "SM2-RNG-004");
        }
        debug_assert!(len > self.max_len);
        violation!(MessageTooLong, "SM2-PAY-010")
    }

    /// Called when the application gives messages back. Returns whether the sender has to be woken,
    /// or the first error.
    //= SM2-RNG-012
    #[inline]
    pub(in crate::link) fn release_all(
        &mut self,
        words: &impl RingMemory,
        sequences: impl IntoIterator<Item = u64>,
        given: Given,
    ) -> Result<Wake, NotReleased> {
        let mut result = Ok(());
        for sequence in sequences {
            result = result.and(self.release(words, sequence, given));
        }
        result.map(|()| wake_parked(words, At::SenderParked))
    }

    /// Puts the word of a message into the next back word.
    //= SM2-RNG-008, SM2-MSG-004, SM2-QOS-010
    #[inline]
    fn release(
        &mut self,
        words: &impl RingMemory,
        sequence: u64,
        given: Given,
    ) -> Result<(), NotReleased> {
        let mut word = self.borrowed.remove(sequence).ok_or(Misuse::NotBorrowed)?;
        if given == Given::Expired {
            word.sequence = !word.sequence;
        }
        let at = self.layout.back_word(self.given);
        self.given += 1;
        if words.swap(at, word.to_bits()) != EMPTY {
            let violation = violation!(BadWord, "SM2-RNG-008");
            return Err(NotReleased::Violation(violation));
        }
        Ok(())
    }

    /// Whether the application holds a message in this segment.
    pub(in crate::link) fn holds(&self, segment: u32) -> bool {
        self.borrowed.is_in(segment)
    }

    /// Ends the receiver's side with the link. After a violation no message can be taken.
    //= SM2-RNG-010
    pub(in crate::link) const fn end(&mut self, by_violation: bool) {
        self.left = Some(if by_violation { 0 } else { self.layout.depth() });
    }

    /// Whether no message can be taken any more.
    pub(in crate::link) fn is_over(&self) -> bool {
        self.left == Some(0)
    }

    /// Checks the invariants, which hold after each call.
    #[inline]
    pub(in crate::link) fn invariants(&self) {
        debug_assert!(self.borrowed.len() <= usize::from(self.max_borrowed));
        debug_assert!(self.left.is_none_or(|left| left <= self.layout.depth()));
    }
}

/// Copies the message in a cell. The copy is whole if the word of the cell is then taken.
#[inline]
fn copy_cell(words: &impl RingMemory, at: At, word: CellWord, cell: &mut [u64; CELL_WORDS]) {
    if let (At::Forward(index), Some(copy)) = (at, cell.get_mut(..word.words())) {
        words.read_cell(index, copy);
    }
}

/// The low half of the sequence number in a forward word.
fn sequence_of(bits: u64) -> Option<u32> {
    let in_slot = || Some(Word::from_bits(bits).ok()??.sequence);
    CellWord::from_bits(bits)
        .map(|it| it.sequence)
        .or_else(in_slot)
}
