//! Several bags as one, with the latched state.

use std::vec::IntoIter;

use super::before::before;
use super::once::Once;
use crate::bag::Bag;
use crate::merged::{Found, Merged};
use crate::messages::Filter;

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
        Self {
            state: state.unwrap_or_default().into_iter(),
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
