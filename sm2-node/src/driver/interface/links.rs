//! The links of one interface.

use std::collections::VecDeque;

use sm2_proto::QosWatch;
use sm2_proto::link::Counters;

use crate::driver::limits::{ENDED_WITH_MESSAGES, HISTORY};
use crate::driver::link::LinkDriver;
use crate::driver::status::LinkStatus;
use crate::driver::token::LinkToken;

/// The links of an interface: those that are announced, those that exist, and those that are over. A link whose end was
/// noticed exists until its messages are taken, but it counts among those that are over.
#[derive(Debug, Default)]
pub(crate) struct Links {
    /// In ascending order of their tokens, the oldest first.
    ///
    /// Each message visits all links several times, and usually there is one link. A vector makes these
    /// visits fast. Its slower removal happens once for each link.
    links: Vec<LinkDriver>,
    /// How many LINKs that DECLARED announced have not come yet (SM2-IFC-002).
    pub(in crate::driver) due: u32,
    ended: EndedLinks,
}

/// The statuses of the last links that are over, at most [`HISTORY`], and the sums over all that ever were.
#[derive(Debug, Default)]
struct EndedLinks {
    /// The oldest first.
    last: VecDeque<LinkStatus>,
    counters: Counters,
    qos: QosCounts,
}

/// How publishers have kept their deadlines and leases.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct QosCounts {
    /// How many periods have passed without a message.
    pub(crate) missed_deadlines: u64,
    /// How often a publisher stopped being alive.
    pub(crate) lost_liveliness: u64,
}

impl Links {
    /// Notes that one of the LINKs that DECLARED announced has come, or will not come.
    pub(in crate::driver) const fn link_came(&mut self) {
        self.due = self.due.saturating_sub(1);
    }

    /// Whether a link is announced or being opened.
    pub(crate) fn is_opening(&self) -> bool {
        self.due > 0 || self.iter().any(LinkDriver::is_opening)
    }

    /// The number of open links.
    pub(crate) fn count_open(&self) -> usize {
        self.iter().filter(|link| link.is_open()).count()
    }

    /// Whether there may be a message to take.
    pub(in crate::driver) fn may_take(&self) -> bool {
        self.iter().any(LinkDriver::may_take)
    }

    /// Whether a link holds memory of the pool. Messages in cells of rings hold none.
    pub(crate) fn hold_memory(&self) -> bool {
        let mut holds = false;
        self.iter()
            .for_each(|link| link.in_flight_keys(|_| holds = true));
        holds
    }

    /// Prepares the links for a thread that is about to sleep until one of them has an event.
    pub(in crate::driver) fn park(&self) {
        self.iter().for_each(LinkDriver::park);
    }

    /// The tokens of the links that `is_wanted` accepts. Allocates only if there is one.
    pub(in crate::driver) fn tokens_of(
        &self,
        is_wanted: impl Fn(&LinkDriver) -> bool,
    ) -> Vec<LinkToken> {
        let wanted = self.iter().filter(|link| is_wanted(link));
        wanted.map(LinkDriver::token).collect()
    }

    /// The oldest links that are over, if more of them have messages than may.
    pub(super) fn surplus(&self) -> Vec<LinkToken> {
        let mut over = self.tokens_of(|link| link.end_noticed);
        over.truncate(over.len().saturating_sub(ENDED_WITH_MESSAGES));
        over
    }

    /// Records the end of a link. Returns the link, if it exists.
    pub(super) fn notice_end(&mut self, token: LinkToken) -> Option<&mut LinkDriver> {
        let place = self.place(token)?;
        let link = &mut self.links[place];
        link.end_noticed = true;
        self.ended.push(link);
        Some(link)
    }

    /// The links whose end was not noticed.
    fn current(&self) -> impl Iterator<Item = &LinkDriver> {
        self.iter().filter(|link| !link.end_noticed)
    }

    /// The statuses of all links, ended links first.
    pub(crate) fn statuses(&self) -> Vec<LinkStatus> {
        let live = self.current().map(LinkDriver::status);
        self.ended.last.iter().cloned().chain(live).collect()
    }

    /// The sum over all links, current and past.
    //= SM2-QOS-006
    pub(crate) fn counters(&self) -> Counters {
        let mut sum = self.ended.counters;
        (self.current()).for_each(|link| sum.add(&link.counters()));
        sum
    }

    /// The same for the publishers at the other ends.
    pub(super) fn qos_counts(&self) -> QosCounts {
        let mut sum = self.ended.qos;
        (self.current()).for_each(|link| sum.add(link.qos_watch()));
        sum
    }

    /// Adds a link with a token greater than all others.
    pub(in crate::driver) fn push(&mut self, link: LinkDriver) {
        debug_assert!((self.links.last()).is_none_or(|last| last.token() < link.token()));
        self.links.push(link);
    }

    pub(crate) fn get(&self, token: LinkToken) -> Option<&LinkDriver> {
        self.links.get(self.place(token)?)
    }

    pub(in crate::driver) fn get_mut(&mut self, token: LinkToken) -> Option<&mut LinkDriver> {
        let place = self.place(token)?;
        self.links.get_mut(place)
    }

    pub(in crate::driver) fn remove(&mut self, token: LinkToken) -> Option<LinkDriver> {
        let place = self.place(token)?;
        Some(self.links.remove(place))
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &LinkDriver> {
        self.links.iter()
    }

    pub(in crate::driver) fn iter_mut(&mut self) -> impl Iterator<Item = &mut LinkDriver> {
        self.links.iter_mut()
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
        if visited.is_none() && self.links.len() == 1 {
            return self.links.first_mut();
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
        let first = self.links.partition_point(|link| link.token() <= start);
        let (up_to_start, after) = self.links.split_at_mut(first);
        let mut turn = after.iter_mut().chain(up_to_start);
        turn.find(|link| place(link.token()) >= least && !link.waits_for_older())
    }

    fn place(&self, token: LinkToken) -> Option<usize> {
        self.links
            .binary_search_by_key(&token, |link| link.token())
            .ok()
    }
}

impl EndedLinks {
    /// Adds a link, when its end is noticed.
    fn push(&mut self, link: &LinkDriver) {
        self.counters.add(&link.counters());
        self.qos.add(link.qos_watch());
        if self.last.len() == HISTORY {
            self.last.pop_front();
        }
        self.last.push_back(link.status());
    }
}

impl QosCounts {
    pub(super) fn add(&mut self, watch: &QosWatch) {
        self.missed_deadlines += watch.missed_deadlines();
        self.lost_liveliness += watch.lost_liveliness();
    }
}
