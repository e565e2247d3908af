//! The peer of the end under test: it puts words, takes words, gives them back, and attaches
//! segments.

use super::{super::NOW, Ring, SLOTS, segment};
use crate::{
    Datagram, FdFacts, Machine, Seals,
    fuzz::Script,
    link::{At, CellWord, Delivery, EMPTY, Input, Payload, Word, wire::Frame},
};

impl Ring<'_> {
    pub(super) fn attached(&mut self, id: u32) {
        let facts = FdFacts {
            regular: true,
            size_bytes: 4_096 * u64::from(SLOTS),
            seals: Seals::POOLED,
        };
        self.world.frame(&Frame::Attach(segment(id)), &[facts]);
    }

    /// The peer takes the word at some index, or gives back a message that it took.
    pub(super) fn peer_takes(&mut self, script: &mut Script<'_>) -> Option<()> {
        let index = u32::from(script.byte()?) % self.outgoing.depth() as u32;
        let bits = self.outgoing.set(At::Forward(index), EMPTY);
        if script.rarely()? {
            // The peer will claim to have taken the message, but leaves its word in the ring.
            self.outgoing.set(At::Forward(index), bits);
        }
        // A message in a cell is not given back.
        if bits != EMPTY && (CellWord::from_bits(bits).is_none() || script.rarely()?) {
            self.taken.push(bits);
        }
        if script.byte()? % 2 == 0 && !self.taken.is_empty() {
            let pick = script.below(8)? % self.taken.len();
            let back = (self.given_back % self.outgoing.window()) as u32;
            (self.outgoing).set(At::Back(back), self.taken.swap_remove(pick));
            self.given_back += 1;
        }
        Some(())
    }

    /// The peer puts the next word, which is usually correct.
    pub(super) fn peer_puts(&mut self, script: &mut Script<'_>) -> Option<()> {
        let sequence = script.near(self.put + 1)?;
        let (segment, slot) = (
            script.below(3)? as u32,
            script.below(SLOTS as u8 + 1)? as u32,
        );
        let index = (sequence % self.incoming.depth()) as u32;
        let word = Word::new(segment, slot, sequence)?;
        self.incoming.set(At::Forward(index), word.to_bits());
        self.put += 1;
        Some(())
    }

    pub(super) fn peer_segments(&mut self, script: &mut Script<'_>) -> Option<()> {
        let id = script.below(3)? as u32;
        if script.byte()? % 2 == 0 {
            self.attached(id);
        } else if self.world.link.end().is_none() {
            let is_held = |it: &Delivery| matches!(it.payload, Payload::Pooled { segment, .. } if segment == id);
            let busy = self.held.iter().any(is_held);
            let bytes = Frame::Detach { segment: id }.to_vec();
            let datagram = Datagram::new(&bytes);
            let result = self.world.link.handle(NOW, Input::Datagram(datagram));
            assert!(!busy || result.is_err(), "it is held");
        }
        self.world.drain();
        Some(())
    }
}
