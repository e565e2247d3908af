//! The receiver's side of a ring: what it expects, and what the application holds.

mod borrowed;
#[cfg(any(kani, test))]
mod proofs;

use self::borrowed::Borrowed;
use super::{
    super::{Delivery, Payload, TooManyBorrowed, frame_kind::Carrier, segments::Geometry},
    At, EMPTY, RingLayout, RingMemory, SlotHead, Wake, Word, wake_parked,
};
use crate::{
    Violation,
    limits::{MESSAGE_MAX, RING_DISPLACED_MAX, SLOT_HEAD},
};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingReceiver {
    layout: RingLayout,
    carrier: Carrier,
    /// Whether the sender may go round.
    displaces: bool,
    max_borrowed: u16,
    /// The number of the message that is expected.
    next: u64,
    /// The id of the last message that was taken.
    last_id: Option<u64>,
    /// How many messages were given back.
    given: u64,
    borrowed: Borrowed,
    /// How many messages can still be taken, once the link is over.
    left: Option<u16>,
}

/// Why no message is taken, although the ring is not empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::link) enum NotTaken {
    TooManyBorrowed(TooManyBorrowed),
    /// No such segment is attached: the socket may say more.
    UnknownSegment,
    Violation(Violation),
}

impl From<Violation> for NotTaken {
    fn from(violation: Violation) -> Self {
        Self::Violation(violation)
    }
}

impl RingReceiver {
    pub(in crate::link) fn new(
        layout: RingLayout,
        carrier: Carrier,
        reliable: bool,
        max_borrowed: u16,
    ) -> Self {
        Self {
            layout,
            carrier,
            displaces: !reliable,
            max_borrowed,
            next: 1,
            last_id: None,
            given: 0,
            borrowed: Borrowed::with_capacity(max_borrowed),
            left: None,
        }
    }

    #[inline]
    pub(in crate::link) const fn layout(&self) -> RingLayout {
        self.layout
    }

    /// Whether there is a message, or a word that is not one.
    pub(in crate::link) fn ready(&self, words: &impl RingMemory) -> bool {
        self.left != Some(0) && words.load(self.layout.forward(self.oldest(words))) != EMPTY
    }

    /// The word that stands where the next message is expected.
    #[inline]
    pub(in crate::link) fn peek(&self, words: &impl RingMemory) -> Option<Word> {
        Word::from_bits(words.load(self.layout.forward(self.next))).ok()?
    }

    /// The message to look for. A sender that died while it made room left an empty word where
    /// its oldest message had been: those behind it are still there.
    //= SM2-RNG-011
    #[inline]
    fn oldest(&self, words: &impl RingMemory) -> u64 {
        if self.left.is_none() || !self.displaces {
            return self.next;
        }
        let last = self.next.saturating_add(u64::from(self.layout.depth()));
        let is_there = |it: &u64| words.load(self.layout.forward(*it)) != EMPTY;
        let oldest = || (self.next..last).find(is_there);
        // Who sees a word sees all that was put before it, but only from then on.
        oldest().and_then(|_| oldest()).unwrap_or(self.next)
    }

    /// How many words name a message.
    pub(in crate::link) fn waiting(&self, words: &impl RingMemory) -> usize {
        if self.left == Some(0) {
            return 0;
        }
        let depth = u32::from(self.layout.depth());
        let words = (0..depth).filter(|index| words.load(At::Forward(*index)) != EMPTY);
        words.count()
    }

    /// The next message for the application. `head` copies the last bytes of the slot that
    /// begins at this offset of this segment and has this length.
    //= SM2-RNG-007, SM2-MSG-005, SM2-PAY-006
    #[inline]
    pub(in crate::link) fn take(
        &mut self,
        words: &impl RingMemory,
        geometry: impl Fn(u32) -> Option<Geometry>,
        head: impl FnOnce(u32, u64, u64) -> Option<[u8; SLOT_HEAD]>,
    ) -> Result<Option<Delivery>, NotTaken> {
        if self.left == Some(0) {
            return Ok(None);
        }
        self.next = self.oldest(words);
        // Each round but the last shows that the sender has gone on meanwhile, or brings us one
        // message nearer to what it left.
        for _ in 0..2 * u32::from(self.layout.depth()) {
            let at = self.layout.forward(self.next);
            let bits = words.load(at);
            let word = Word::from_bits(bits);
            let word = word.map_err(|_| violation!(BadWord, "SM2-RNG-007"))?;
            let Some(word) = word else {
                return Ok(None);
            };
            if !self.is_expected(word)? {
                continue;
            }
            if self.borrowed.len() >= usize::from(self.max_borrowed) {
                return Err(NotTaken::TooManyBorrowed(TooManyBorrowed {
                    max_borrowed: self.max_borrowed,
                }));
            }
            let segment = u32::from(word.segment);
            let geometry = geometry(segment).ok_or(NotTaken::UnknownSegment)?;
            let offset = (geometry.offset(u32::from(word.slot)))
                .ok_or(violation!(BadSlot, "SM2-RNG-007"))?;
            if words.take(at, bits) {
                let head = head(segment, offset, geometry.stride());
                return self.taken(word, geometry, offset, head).map(Some);
            }
        }
        Ok(None)
    }

    /// Whether this is the word of the message that is expected. If the sender went round,
    /// another one is from here on.
    //= SM2-RNG-007
    #[inline]
    fn is_expected(&mut self, word: Word) -> Result<bool, Violation> {
        let ahead = u64::from(word.sequence.wrapping_sub(self.next as u32));
        if ahead == 0 {
            return Ok(true);
        }
        let depth = u64::from(self.layout.depth());
        // What seems to be further ahead than a sender goes is a word of the past.
        let is_later = ahead.is_multiple_of(depth) && ahead < u64::from(RING_DISPLACED_MAX) + depth;
        if !self.displaces || !is_later {
            return Err(violation!(BadWord, "SM2-RNG-007"));
        }
        let next = self.next.checked_add(ahead - (depth - 1));
        self.next = next.ok_or(violation!(BadWord, "SM2-RNG-007"))?;
        Ok(false)
    }

    /// The word was taken out of the ring.
    //= SM2-RNG-004, SM2-PAY-005, SM2-PAY-008, SM2-MSG-002, SM2-SRV-002
    #[inline]
    fn taken(
        &mut self,
        word: Word,
        geometry: Geometry,
        offset: u64,
        head: Option<[u8; SLOT_HEAD]>,
    ) -> Result<Delivery, NotTaken> {
        let sequence = self.next;
        self.next = sequence
            .checked_add(1)
            .ok_or(violation!(BadWord, "SM2-RNG-007"))?;
        if self.borrowed.is_at(word) {
            return Err(violation!(SlotBusy, "SM2-RNG-007").into());
        }
        let head = SlotHead::from_bytes(&head.ok_or(NotTaken::UnknownSegment)?, self.carrier)?;
        let last_id = self.last_id;
        if self.carrier != Carrier::Reply && head.id <= last_id.unwrap_or(0) {
            return Err(violation!(BadId, "SM2-RNG-004").into());
        }
        if head.len > MESSAGE_MAX || head.len > geometry.stride() - SLOT_HEAD as u64 {
            return Err(violation!(BadLength, "SM2-RNG-004").into());
        }
        let lost = match (self.carrier, last_id) {
            (Carrier::Data, Some(last)) => head.id - last - 1,
            // Before the first, each message that was displaced had a sequence number.
            (Carrier::Data, None) => sequence - 1,
            (Carrier::Request | Carrier::Reply, _) => 0,
        };
        self.last_id = Some(head.id);
        self.borrowed.push(sequence, word);
        if let Some(left) = &mut self.left {
            *left -= 1;
        }
        Ok(Delivery {
            sequence,
            id: head.id,
            time: head.time,
            status: head.status,
            lost,
            len: head.len,
            payload: Payload::Pooled {
                segment: u32::from(word.segment),
                offset,
            },
        })
    }

    /// The application gives a message back. `None` if the application does not hold it, else
    /// whether the sender has to be woken.
    //= SM2-RNG-008, SM2-MSG-004
    pub(in crate::link) fn release(
        &mut self,
        words: &impl RingMemory,
        sequence: u64,
    ) -> Option<Result<Wake, Violation>> {
        let word = self.borrowed.remove(sequence)?;
        let at = self.layout.back_word(self.given);
        self.given += 1;
        if words.swap(at, word.to_bits()) != EMPTY {
            return Some(Err(violation!(BadWord, "SM2-RNG-008")));
        }
        Some(Ok(wake_parked(words, At::SenderParked)))
    }

    /// Whether the application holds a message in this segment.
    pub(in crate::link) fn holds(&self, segment: u32) -> bool {
        self.borrowed.is_in(segment)
    }

    /// The link is over.
    //= SM2-RNG-011
    pub(in crate::link) const fn end(&mut self, by_violation: bool) {
        self.left = Some(if by_violation { 0 } else { self.layout.depth() });
    }

    /// Whether nothing can be taken any more.
    pub(in crate::link) fn is_over(&self) -> bool {
        self.left == Some(0)
    }

    /// What must hold between any two calls.
    #[inline]
    pub(in crate::link) fn invariants(&self) {
        debug_assert!(self.borrowed.len() <= usize::from(self.max_borrowed));
        debug_assert!(self.left.is_none_or(|left| left <= self.layout.depth()));
    }
}
