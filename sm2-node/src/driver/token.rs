//! The tokens that a node gives to the descriptors in its epoll sets.

/// The token of a link's socket. Tokens increase with each link of the node and are never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct LinkToken(pub(super) u64);

impl LinkToken {
    /// Less than the token of every link. The session's socket has this token.
    pub(crate) const FIRST: Self = Self(0);
    /// Greater than the tokens of all links and of [`PROGRAM`]. The timer for the next attempt to connect has
    /// this token.
    pub(super) const LAST: Self = Self(u64::MAX);

    /// The token of the next link.
    pub(super) const fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

/// The token of the session's socket.
pub(super) const SESSION: u64 = LinkToken::FIRST.0;
/// The token of the timer: for the next attempt to connect, or for the next look for room.
pub(super) const TIMER: u64 = LinkToken::LAST.0;
/// The token of all descriptors in the program set but the sets of interfaces, which have their numbers.
pub(super) const PROGRAM: u64 = TIMER - 1;
/// The token of the timer of deadlines.
pub(super) const QOS_TIMER: u64 = PROGRAM - 1;
/// The token of the waker for memory that is given back in parts.
pub(super) const LEFTOVERS: u64 = QOS_TIMER - 1;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_descriptors_have_the_same_token() {
        let fixed = [SESSION, TIMER, PROGRAM, QOS_TIMER, LEFTOVERS];
        let first = LinkToken::FIRST.next();
        let links = [first, first.next(), LinkToken(1 << 60)].map(|it| it.0);
        let mut all = [&fixed[..], &links].concat();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), fixed.len() + links.len());
        assert!(LinkToken::FIRST < first && first < first.next());
        // A link has one of the numbers in between, however long the node runs.
        let reserved = fixed.iter().filter(|it| **it > 1 << 60);
        assert_eq!(reserved.count(), 4);
    }
}
