//! The links of one interface.

use crate::driver::link::LinkDriver;
use crate::driver::token::LinkToken;

/// Links in ascending order of their tokens, the oldest first.
///
/// Each message visits all links several times, and usually there is one link. A vector makes these
/// visits fast. Its slower removal happens once for each link.
#[derive(Debug, Default)]
pub(in crate::driver) struct Links(Vec<LinkDriver>);

impl Links {
    /// Adds a link with a token greater than all others.
    pub(in crate::driver) fn push(&mut self, link: LinkDriver) {
        debug_assert!((self.0.last()).is_none_or(|last| last.token() < link.token()));
        self.0.push(link);
    }

    pub(in crate::driver) fn get(&self, token: LinkToken) -> Option<&LinkDriver> {
        self.0.get(self.place(token)?)
    }

    pub(in crate::driver) fn get_mut(&mut self, token: LinkToken) -> Option<&mut LinkDriver> {
        let place = self.place(token)?;
        self.0.get_mut(place)
    }

    pub(in crate::driver) fn remove(&mut self, token: LinkToken) -> Option<LinkDriver> {
        let place = self.place(token)?;
        Some(self.0.remove(place))
    }

    pub(in crate::driver) fn iter(&self) -> impl Iterator<Item = &LinkDriver> {
        self.0.iter()
    }

    pub(in crate::driver) fn iter_mut(&mut self) -> impl Iterator<Item = &mut LinkDriver> {
        self.0.iter_mut()
    }

    /// The next link in turn. A turn visits the links after `start` in order, and then the others up
    /// to and including `start`, without those that wait for an older one. `visited` is the link that this
    /// turn visited last, if any.
    #[inline]
    pub(in crate::driver) fn next(
        &mut self,
        start: LinkToken,
        visited: Option<LinkToken>,
    ) -> Option<&mut LinkDriver> {
        // A link waits only while there is an older one.
        if visited.is_none() && self.0.len() == 1 {
            return self.0.first_mut();
        }
        self.next_of_many(start, visited)
    }

    fn next_of_many(
        &mut self,
        start: LinkToken,
        visited: Option<LinkToken>,
    ) -> Option<&mut LinkDriver> {
        let place = |token: LinkToken| token.0.wrapping_sub(start.0).wrapping_sub(1);
        let least = visited.map_or(0, |visited| place(visited).saturating_add(1));
        let first = self.0.partition_point(|link| link.token() <= start);
        let (up_to_start, after) = self.0.split_at_mut(first);
        let mut turn = after.iter_mut().chain(up_to_start);
        turn.find(|link| place(link.token()) >= least && !link.waits_for_older())
    }

    fn place(&self, token: LinkToken) -> Option<usize> {
        self.0
            .binary_search_by_key(&token, |link| link.token())
            .ok()
    }
}
