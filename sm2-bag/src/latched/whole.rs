//! Several bags as one, with the latched state.

use std::vec::IntoIter;

use super::before::before;
use super::once::Once;
use crate::bag::Bag;
use crate::error::ReadError;
use crate::merged::{Found, Merged};
use crate::messages::{BagMessage, Filter, FoundMessage};

/// The messages of a bag that may have several files, in the order of their `log_time`, each with the number of its
/// file. A message that later files repeat comes once.
pub fn messages<'a>(
    files: &'a [Bag],
    filter: &Filter,
) -> impl Iterator<Item = (usize, Result<BagMessage, ReadError>)> + use<'a> {
    let found = Whole::stateless(files, filter);
    found.map(|(file, message)| (file, message.and_then(FoundMessage::read)))
}

/// The messages of several bags in the order of their `log_time`, each latched one once. If the filter has a first
/// time, the latched state as of then comes first. A part that is damaged may be told twice.
pub(crate) struct Whole<'a> {
    state: IntoIter<Found<'a>>,
    merged: Merged<'a>,
    once: Once,
}

impl<'a> Whole<'a> {
    pub(crate) fn new(bags: &'a [Bag], filter: &Filter) -> Self {
        let state = filter.from_ns.map(|from_ns| before(bags, filter, from_ns));
        Self::behind(state.unwrap_or_default(), bags, filter)
    }

    /// Without the latched state.
    pub(crate) fn stateless(bags: &'a [Bag], filter: &Filter) -> Self {
        Self::behind(Vec::new(), bags, filter)
    }

    fn behind(state: Vec<Found<'a>>, bags: &'a [Bag], filter: &Filter) -> Self {
        Self {
            state: state.into_iter(),
            merged: Merged::new(bags, filter),
            once: Once::new(bags),
        }
    }
}

impl<'a> Iterator for Whole<'a> {
    type Item = Found<'a>;

    fn next(&mut self) -> Option<Found<'a>> {
        loop {
            let (bag, found) = self.state.next().or_else(|| self.merged.next())?;
            match &found {
                Ok(message) if !self.once.admits(bag, message) => {}
                _ => return Some((bag, found)),
            }
        }
    }
}
