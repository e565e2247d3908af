//! The messages of several bags in the order of their times.

use std::collections::BTreeMap;

use crate::bag::Bag;
use crate::error::ReadError;
use crate::messages::{BagMessage, Filter, Messages};

/// The messages of several bags in the order of their `log_time`, each with the number of its bag. Messages of the same
/// time keep the order of the bags.
pub(crate) struct Merged<'a> {
    bags: Vec<Messages<'a>>,
    /// The next message of each bag.
    next: BTreeMap<(u64, usize), BagMessage>,
}

impl<'a> Merged<'a> {
    pub(crate) fn new(bags: &'a [Bag], filter: &Filter) -> Result<Self, ReadError> {
        let messages = bags.iter().map(|bag| bag.messages(filter));
        let mut merged = Self {
            bags: messages.collect::<Result<_, _>>()?,
            next: BTreeMap::new(),
        };
        for number in 0..merged.bags.len() {
            merged.read(number)?;
        }
        Ok(merged)
    }

    /// Reads the next message of a bag.
    fn read(&mut self, number: usize) -> Result<(), ReadError> {
        if let Some(message) = self.bags[number].next().transpose()? {
            self.next.insert((message.log_time, number), message);
        }
        Ok(())
    }
}

impl Iterator for Merged<'_> {
    type Item = Result<(usize, BagMessage), ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        let ((_, number), message) = self.next.pop_first()?;
        Some(self.read(number).map(|()| (number, message)))
    }
}
