//! The messages of several bags in the order of their times.

use std::collections::BTreeMap;

use crate::bag::Bag;
use crate::error::ReadError;
use crate::messages::{Filter, FoundMessage, Messages};

/// A message, or a fault, with the number of its bag.
pub(crate) type Found<'a> = (usize, Result<FoundMessage<'a>, ReadError>);

/// The messages of several bags in the order of their `log_time`, each with the number of its bag. Messages of the same
/// time keep the order of the bags.
pub(crate) struct Merged<'a> {
    bags: Vec<Messages<'a>>,
    /// The next message of each bag but those of `unread`.
    next: BTreeMap<(u64, usize), FoundMessage<'a>>,
    /// The bags whose next message has to be found.
    unread: Vec<usize>,
}

impl<'a> Merged<'a> {
    pub(crate) fn new(bags: &'a [Bag], filter: &Filter) -> Self {
        Self {
            bags: bags.iter().map(|bag| bag.messages(filter)).collect(),
            next: BTreeMap::new(),
            unread: (0..bags.len()).collect(),
        }
    }
}

impl<'a> Iterator for Merged<'a> {
    type Item = Found<'a>;

    /// The next message, or an error of a bag. A bag is read as late as possible, so that its damage comes after the
    /// messages before it.
    fn next(&mut self) -> Option<Self::Item> {
        while let Some(number) = self.unread.pop() {
            match self.bags[number].find() {
                Ok(None) => {}
                Ok(Some(message)) => {
                    self.next.insert((message.log_time, number), message);
                }
                Err(error) => {
                    // There may be messages behind the damage.
                    self.unread.push(number);
                    return Some((number, Err(error)));
                }
            }
        }
        let ((_, number), message) = self.next.pop_first()?;
        self.unread.push(number);
        Some((number, Ok(message)))
    }
}
