//! The identity of a publisher and the number of its publications, as the OPEN of a sender states them.

/// The identity of a publisher and the number of its publications (SM2-OPN-006). From it, a subscriber that had a link
/// with the same publisher before learns how many messages were published in between.
//= SM2-OPN-006
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Publications {
    /// A random number that the publisher keeps as long as it exists. 0 if the publisher does not say it.
    pub publisher: u64,
    /// The number of its publications before OPEN, which is the `id` of the last one. 0 if `publisher` is 0.
    pub published: u64,
}

impl Publications {
    /// The publisher does not say how many messages it has published.
    pub const UNKNOWN: Self = Self {
        publisher: 0,
        published: 0,
    };

    /// Whether the publisher does not say how many messages it has published.
    #[must_use]
    pub const fn is_unknown(self) -> bool {
        self.publisher == 0
    }

    /// Whether OPEN may have these values: a publisher that does not say its number does not say the other one
    /// either, and all ends but a sender say neither.
    pub(super) const fn is_legal(self, from_sender: bool) -> bool {
        self.published == 0 && self.is_unknown() || from_sender && !self.is_unknown()
    }
}
