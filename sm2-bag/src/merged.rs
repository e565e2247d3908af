//! The messages of several bags in the order of their times.

use std::collections::BTreeMap;

use crate::bag::Bag;
use crate::error::ReadError;
use crate::messages::{Filter, FoundMessage, Messages};

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

    /// The next message. A bag is read as late as possible, so that its damage comes after the messages before it.
    fn find(&mut self) -> Result<Option<(usize, FoundMessage<'a>)>, ReadError> {
        while let Some(number) = self.unread.pop() {
            let found = self.bags[number].find();
            if found.is_err() {
                // There may be messages behind the damage.
                self.unread.push(number);
            }
            if let Some(message) = found? {
                self.next.insert((message.log_time, number), message);
            }
        }
        let Some(((_, number), message)) = self.next.pop_first() else {
            return Ok(None);
        };
        self.unread.push(number);
        Ok(Some((number, message)))
    }
}

impl<'a> Iterator for Merged<'a> {
    type Item = Result<(usize, FoundMessage<'a>), ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.find().transpose()
    }
}
