//! Whether a reliable link owes: then its publisher waits for it no more.
//!
//! Debts keep one bad link from using up the time that a publisher may wait for the honest ones. A debt lasts until all
//! messages that were in flight have come back. If it lasted until nothing is in flight, it would never end for a
//! subscriber that always keeps its newest sample.

/// The debt of a link. A link incurs it with a publication that is not sent because there is no room, or because of
/// the pool limit, and pays it when the other end has given back each message that was in flight then.
///
/// | event | no debt | owes `left` messages |
/// | --- | --- | --- |
/// | [`incur`](Self::incur), nothing in flight | no debt | no debt |
/// | [`incur`](Self::incur), `n` in flight | owes `n` | owes `n` |
/// | [`settle`](Self::settle) of a message up to `last` | no debt | owes `left - 1`, none at 0 |
/// | [`settle`](Self::settle) of a later message | no debt | owes `left` |
/// | [`clear`](Self::clear) | no debt | no debt |
///
/// Messages are numbered in the order in which they were sent, by any increasing number.
//= SM2-QOS-003
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(in crate::link) struct Debt {
    /// The number of the newest message in flight when the debt was incurred; 0 without a debt.
    last: u64,
    /// How many messages up to `last` are in flight.
    left: u64,
}

impl Debt {
    /// A publication is not sent on the link. `last` is the number of the newest message that was sent, and
    /// `in_flight` the number of messages in flight.
    #[inline]
    pub(in crate::link) const fn incur(&mut self, last: u64, in_flight: u64) {
        *self = match in_flight {
            0 => Self { last: 0, left: 0 },
            left => Self { last, left },
        };
    }

    /// A message in flight is settled.
    #[inline]
    pub(in crate::link) const fn settle(&mut self, number: u64) {
        if number <= self.last && self.left > 0 {
            self.left -= 1;
            if self.left == 0 {
                self.last = 0;
            }
        }
    }

    /// The link ended.
    pub(in crate::link) const fn clear(&mut self) {
        *self = Self { last: 0, left: 0 };
    }

    /// How many messages have to come back until the link owes no more.
    pub(in crate::link) const fn left(&self) -> u64 {
        self.left
    }

    /// Whether the link owes.
    #[inline]
    pub(in crate::link) const fn is_owed(&self) -> bool {
        self.left > 0
    }
}

#[cfg(test)]
mod tests {
    use alloc::collections::BTreeSet;
    use alloc::vec::Vec;

    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::Debt;

    #[test]
    fn a_debt_is_paid_with_the_messages_of_its_moment() {
        let mut debt = Debt::default();
        debt.incur(0, 0);
        assert!(!debt.is_owed(), "nothing can be given back");
        debt.incur(3, 2);
        debt.settle(4);
        debt.settle(3);
        assert!(debt.is_owed());
        debt.settle(2);
        assert_eq!(debt, Debt::default());
        debt.settle(1);
        assert_eq!(debt, Debt::default());
    }

    #[derive(Clone, Copy, Debug)]
    enum Step {
        Send,
        Miss,
        Settle(prop::sample::Index),
    }

    proptest! {
        /// A link owes exactly while a message is in flight that was in flight when a publication last missed it.
        //= SM2-QOS-003 test
        #[test]
        fn a_link_owes_what_was_in_flight(steps in vec(prop_oneof![
            Just(Step::Send),
            Just(Step::Miss),
            any::<prop::sample::Index>().prop_map(Step::Settle),
        ], 0..200)) {
            let mut debt = Debt::default();
            let (mut last, mut in_flight, mut owed) = (0, Vec::new(), BTreeSet::new());
            for step in steps {
                match step {
                    Step::Send => {
                        last += 1;
                        in_flight.push(last);
                    }
                    Step::Miss => {
                        debt.incur(last, in_flight.len() as u64);
                        owed = in_flight.iter().copied().collect();
                    }
                    Step::Settle(index) if !in_flight.is_empty() => {
                        let number = in_flight.swap_remove(index.index(in_flight.len()));
                        debt.settle(number);
                        owed.remove(&number);
                    }
                    Step::Settle(_) => {}
                }
                prop_assert_eq!(debt.is_owed(), !owed.is_empty());
            }
        }
    }
}
