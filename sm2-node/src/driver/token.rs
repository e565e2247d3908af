//! The tokens that a node gives to the descriptors in its epoll set.

/// The token of a link's socket. Tokens grow with each link of the node and are never used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct LinkToken(pub(super) u64);

impl LinkToken {
    /// Less than the token of every link: the session's socket has this number.
    pub(crate) const FIRST: Self = Self(0);
    /// Greater than the token of every link: the timer of the next attempt to connect has this
    /// number.
    pub(super) const LAST: Self = Self(u64::MAX);

    /// The token of the link after this one.
    pub(super) const fn next(self) -> Self {
        Self(self.0 + 1)
    }
}
