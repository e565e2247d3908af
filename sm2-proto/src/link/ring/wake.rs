//! Waking the other end of a ring: parked words, and DOORBELL.

use super::{
    super::{packet::Head, wire::Frame},
    At, EMPTY, RingMemory,
};

/// Whether the other end sleeps and has to be woken.
#[must_use = "if it is needed, the other end sleeps until it is sent a DOORBELL"]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wake {
    /// Send [`doorbell`] by the socket. The driver ignores whether the socket takes it: a socket
    /// that is full is readable at its other end.
    Needed,
    /// The other end is awake, or its socket wakes it.
    #[default]
    NotNeeded,
}

impl Wake {
    /// Whether [`doorbell`] has to be sent.
    #[inline]
    pub const fn is_needed(self) -> bool {
        matches!(self, Self::Needed)
    }

    /// Needed if either is.
    #[inline]
    pub const fn or(self, other: Self) -> Self {
        match self {
            Self::Needed => self,
            Self::NotNeeded => other,
        }
    }
}

/// The datagram that wakes the other end.
//= SM2-RNG-009
#[must_use]
pub fn doorbell() -> Head {
    Frame::Doorbell.head()
}

/// After a word was put: takes the mark out of the other end's `parked` word, if it is there.
//= SM2-RNG-009
#[inline]
pub(in crate::link) fn wake_parked(words: &impl RingMemory, parked: At) -> Wake {
    // Pairs with the fence in `Link::park`: either the other end sees our word when it looks again,
    // or we see that it parked.
    words.fence();
    if words.load(parked) != EMPTY && words.swap(parked, EMPTY) == 1 {
        Wake::Needed
    } else {
        Wake::NotNeeded
    }
}
