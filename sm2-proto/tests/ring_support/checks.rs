//! Invariants of a pair of ends of the ring lane, during a run and at its end.

use sm2_proto::link::{CellWord, Counters, EMPTY, End, Fate, LaneKind, Word};

use crate::ring_support::{ends::Sent, pair::Pair};

impl Pair {
    /// Checks the invariants that hold between any two operations.
    pub(crate) fn check(&mut self) {
        for at in [&self.sending.at, &self.receiving.at] {
            assert!(!matches!(at.link.end(), Some(End::Violation(_))), "honest");
            assert_eq!(at.ended, at.link.end().is_some());
        }
        for delivery in &self.receiving.held {
            self.shared.check_content(delivery);
        }
        self.settle_cells();
        self.check_counters();
        self.check_taken();
        if self.sound {
            self.check_ring();
            self.check_awake();
        }
    }

    /// Notes the fates of messages in cells. A message is displaced if it was not taken when its
    /// index got another one. One that was taken then was delivered.
    //= SM2-RNG-013 test
    fn settle_cells(&mut self) {
        if !self.sound {
            return;
        }
        let newest = self.sending.sent.len() as u64;
        let taken = &self.receiving.taken;
        for sent in &mut self.sending.sent {
            let is_replaced = sent.sequence + self.depth <= newest;
            if sent.place.is_none() && sent.fate.is_none() && is_replaced {
                let is_taken = taken.binary_search(&(sent.sequence, sent.id)).is_ok();
                sent.fate = Some(match is_taken {
                    true => Fate::Delivered,
                    false => Fate::Discarded,
                });
            }
        }
    }

    /// How many messages in slots are not settled.
    pub(crate) fn slots_in_flight(&self) -> usize {
        let in_flight = |it: &&Sent| it.place.is_some() && it.fate.is_none();
        self.sending.sent.iter().filter(in_flight).count()
    }

    /// How many messages in cells are in the ring.
    pub(crate) fn cells_in_ring(&self) -> usize {
        let words = self.shared.words.forward().into_iter();
        words.filter_map(CellWord::from_bits).count()
    }

    /// A message in a cell is settled when its index gets another message, or when the sender looks
    /// for what came back, so until then it can be in flight although it was taken.
    //= SM2-QOS-006, SM2-RNG-013 test
    fn check_counters(&self) {
        let sending = &self.sending;
        if !self.sound {
            return;
        }
        let tally = |fate| sending.sent.iter().filter(|it| it.fate == fate).count() as u64;
        let counters = sending.at.link.counters();
        let in_flight = tally(None);
        let least = (self.slots_in_flight() + self.cells_in_ring()) as u64;
        assert!((least..=in_flight).contains(&counters.in_flight));
        let noticed = in_flight - counters.in_flight;
        let expected = Counters {
            offered: sending.sent.len() as u64 + sending.skipped + sending.overwritten,
            delivered: tally(Some(Fate::Delivered)) + noticed,
            overwritten: sending.overwritten,
            discarded: tally(Some(Fate::Discarded)),
            no_room: sending.skipped,
            in_flight: counters.in_flight,
            ..Counters::default()
        };
        assert_eq!(counters, expected);
    }

    /// Every taken message was sent; they are taken in order and once; and no taken message was
    /// displaced.
    //= SM2-RNG-007, SM2-MSG-001, SM2-MSG-002 test
    fn check_taken(&self) {
        let taken = &self.receiving.taken;
        assert!(taken.windows(2).all(|pair| pair[0] < pair[1]));
        for (sequence, id) in taken {
            let sent = &self.sending.sent[*sequence as usize - 1];
            assert_eq!((sent.sequence, sent.id), (*sequence, *id));
            assert_ne!(sent.fate, Some(Fate::Discarded));
        }
        if self.reliable {
            let all = (1..).zip(taken);
            assert!(all.into_iter().all(|(expected, it)| it.0 == expected));
            let lost = |fate| matches!(fate, Some(Fate::Discarded | Fate::Overwritten));
            assert!(!self.sending.sent.iter().any(|it| lost(it.fate)));
        }
    }

    /// The ring has exactly the last `depth` messages, except the taken ones. All earlier messages
    /// that were not taken are discarded.
    //= SM2-QOS-001, SM2-RNG-005 test
    fn check_ring(&self) {
        let newest = self.sending.sent.len() as u64;
        let last_taken = self.receiving.taken.last().map_or(0, |it| it.0);
        let oldest = (last_taken + 1).max((newest + 1).saturating_sub(self.depth));
        assert_eq!(self.in_ring(), (oldest..=newest).collect::<Vec<_>>());
        let mut taken = self.receiving.taken.iter().map(|it| it.0).peekable();
        for sent in &self.sending.sent {
            let was_taken = taken.next_if_eq(&sent.sequence).is_some();
            let displaced = !was_taken && sent.sequence < oldest;
            assert_eq!(sent.fate == Some(Fate::Discarded), displaced);
        }
    }

    /// The sequence numbers in the ring, in ascending order.
    fn in_ring(&self) -> Vec<u64> {
        let words = self.shared.words.forward().into_iter();
        let sequence = |bits| match CellWord::from_bits(bits) {
            Some(cell) => Some(cell.sequence),
            None => Word::from_bits(bits).unwrap().map(|it| it.sequence),
        };
        let mut sequences: Vec<u64> = words.filter_map(sequence).map(u64::from).collect();
        sequences.sort_unstable();
        sequences
    }

    /// An end sleeps only if it has nothing to do, or if a datagram is about to wake it.
    //= SM2-RNG-012 test
    fn check_awake(&self) {
        let ends = [&self.sending.at, &self.receiving.at];
        for end in [0, 1] {
            let may_sleep = self.is_idle(end) || !ends[1 - end].wire.is_empty();
            assert!(!ends[end].asleep || may_sleep, "end {end} sleeps for ever");
        }
    }

    /// Lets both ends finish all work: the sockets are open, and the applications take everything.
    pub(crate) fn run_until_quiet(&mut self) {
        let mut left = None;
        for _ in 0..200 {
            for end in [0, 1] {
                self.set_full(end, false);
                self.drain();
                self.carry(end);
            }
            if self.sending.at.ended && self.receiving.at.ended && left.is_none() {
                left = Some(self.in_ring());
            }
            self.take();
            self.drain();
            self.receiving.release(&self.shared.words, &self.shared, 0);
            self.harvest();
            self.drain();
            self.check();
        }
        let taken = &self.receiving.taken;
        if self.sound {
            assert!(self.sending.at.link.is_open() && self.receiving.at.link.is_open());
            let sent = &self.sending.sent;
            let counters = self.sending.at.link.counters();
            assert_eq!(counters.in_flight, 0, "all is settled");
            assert_eq!(counters.delivered, taken.len() as u64);
            // The last messages in cells were taken, and nothing has replaced them.
            let is_delivered = |it: &&Sent| match it.place {
                Some(_) => it.fate == Some(Fate::Delivered),
                None => it.fate != Some(Fate::Discarded),
            };
            let delivered = sent.iter().filter(is_delivered);
            let delivered: Vec<u64> = delivered.map(|it| it.sequence).collect();
            let taken: Vec<u64> = taken.iter().map(|it| it.0).collect();
            assert_eq!(taken, delivered, "what was delivered is what was taken");
            assert_eq!(taken.last().copied(), sent.last().map(|it| it.sequence));
            assert_eq!(
                self.shared.words.back(),
                vec![EMPTY; self.shared.words.back().len()]
            );
        } else {
            assert!(self.sending.at.ended && self.receiving.at.ended);
            let is_settled = |it: &Sent| it.place.is_none() || it.fate.is_some();
            assert!(self.sending.sent.iter().all(is_settled));
            let counters = self.sending.at.link.counters();
            assert!(counters.is_balanced() && counters.in_flight == 0);
            // A receiver that has ended may not have read OPEN, or not every ATTACH.
            let has_opened = self.receiving.at.link.lane() == LaneKind::Ring;
            if self.receiving.is_dead
                || !has_opened
                || self.receiving.take(&self.shared.words, &self.shared)
            {
                return;
            }
            // The receiver takes as many messages as it may after the end.
            let taken = &self.receiving.taken;
            let after = taken.len() - self.receiving.taken_before_end.unwrap_or(taken.len());
            assert!(self.in_ring().is_empty() || after as u64 == self.depth);
            for sequence in left.into_iter().flatten() {
                let was_taken = taken.iter().any(|it| it.0 == sequence);
                assert!(
                    was_taken || after as u64 == self.depth,
                    "{sequence} was left"
                );
            }
        }
    }
}
