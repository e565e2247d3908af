//! The words of rings that the next messages fill, for threads that spin.
//!
//! A thread that spins would need the lock of its interface, and much more, for each look. It watches these words
//! instead, without the lock, and takes the lock once one of them is filled.

use std::hint;
use std::sync::Arc;

use sm2_io::Ring;
use sm2_proto::link::{At, EMPTY, RingMemory};

/// How many words are watched. A thread that spins for more links takes the lock for each look.
const WORDS: usize = 4;

/// How many looks at the words there are for each use of the lock, which also looks at the time and at the sockets.
const LOOKS: u32 = 32;

/// The words that the next messages of an interface fill.
#[derive(Debug, Default)]
pub(super) struct NextWords([Option<(Arc<Ring>, At)>; WORDS]);

impl NextWords {
    /// These words, or none if there are more than can be watched.
    pub(super) fn of(words: impl Iterator<Item = (Arc<Ring>, At)>) -> Self {
        let mut watched = Self::default();
        for (number, word) in words.enumerate() {
            match watched.0.get_mut(number) {
                Some(place) => *place = Some(word),
                None => return Self::default(),
            }
        }
        watched
    }

    /// Spins until one of the words is filled, for about a microsecond. If there are no words, makes `pauses` of the
    /// processor instead. Returns whether a word is filled.
    pub(super) fn spin(&self, pauses: u32) -> bool {
        let looks = if self.0[0].is_some() { LOOKS } else { pauses };
        for _ in 0..looks {
            let mut words = self.0.iter().flatten();
            if let Some((ring, at)) = words.find(|(ring, at)| ring.load(*at) != EMPTY) {
                ring.prefetch(*at);
                return true;
            }
            hint::spin_loop();
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::link::RingLayout;

    use super::*;

    fn ring() -> Arc<Ring> {
        let layout = RingLayout::new(2, 3).unwrap();
        Arc::new(Ring::create(layout).unwrap().0)
    }

    #[test]
    fn as_many_words_are_watched_as_there_is_room_for() {
        let ring = ring();
        for links in 0..=WORDS + 1 {
            let words = (0..links).map(|_| (Arc::clone(&ring), At::Forward(0)));
            let watched = NextWords::of(words).0.iter().flatten().count();
            assert_eq!(watched, if links > WORDS { 0 } else { links });
        }
    }

    #[test]
    fn a_filled_word_is_seen_and_empty_ones_do_not_hold_up_the_thread() {
        let ring = ring();
        let words = || [(Arc::clone(&ring), At::Forward(1))].into_iter();
        assert!(!NextWords::of(words()).spin(1));
        assert!(!NextWords::default().spin(1));
        ring.swap(At::Forward(1), 1);
        assert!(NextWords::of(words()).spin(1));
    }
}
