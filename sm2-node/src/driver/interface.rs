//! One declared interface: its links, what it has on its way out, and the calls it made.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound::{Excluded, Included, Unbounded};
use std::sync::Arc;

use sm2_io::Event;
use sm2_proto::control::Peer;
use sm2_proto::link::{Counters, Delivery, End, Input, Status, TooManyBorrowed};
use sm2_proto::{Code, Contract, Farewell, LinkId, Refusal};

use super::calls::Calls;
use super::link::{LinkDriver, TakeError, Tools};
use super::outbox::{Forms, Label, Needs, Outbox};
use crate::{Payload, Published};

/// How many links that ended are remembered one by one; of older ones only the sum is.
const HISTORY: usize = 64;
/// How many links that ended may still have messages that the application did not take.
const ENDED_WITH_MESSAGES: usize = 64;

#[derive(Debug)]
pub(crate) struct Interface {
    pub(crate) contract: Contract,
    pub(crate) state: State,
    /// By token: the oldest first.
    links: BTreeMap<u64, LinkDriver>,
    pub(crate) outbox: Outbox,
    /// Keys of the last messages, the oldest first.
    latched: VecDeque<u64>,
    /// How many messages were published.
    published: u64,
    pub(super) calls: Calls,
    /// How many LINK frames came.
    pub(super) linked: u32,
    /// The link from which the last message was taken.
    last_taken: u64,
    /// How many publications the application will never see, as far as it knows.
    pub(crate) lost: u64,
    ended: VecDeque<LinkStatus>,
    ended_sum: Counters,
    /// Links that are over, for the Manager to know.
    pub(super) farewells: Vec<(LinkId, Code)>,
    /// Tokens of links that are no more.
    pub(super) gone: Vec<u64>,
}

/// How far the declaration has come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Declaring,
    Live { matches: u32 },
    Refused(Refusal),
}

/// One link of an interface, now or in the past.
#[derive(Clone, Debug)]
pub struct LinkStatus {
    /// Its id.
    pub id: LinkId,
    /// The interface at its other end: node, name, contract.
    pub peer: Arc<Peer>,
    /// Whether both sides have opened it.
    pub open: bool,
    /// Whether nothing on it may be displaced.
    pub reliable: bool,
    /// Whether every message on it is inline or sealed.
    pub sealed: bool,
    /// What became of the messages that this side sent on it (SM2-QOS-004).
    pub counters: Counters,
    /// Why it is over, if it is.
    pub end: Option<End>,
}

impl Interface {
    pub(super) fn new(contract: Contract, pool_limit_bytes: u64) -> Self {
        Self {
            contract,
            state: State::Declaring,
            links: BTreeMap::new(),
            outbox: Outbox::new(pool_limit_bytes),
            latched: VecDeque::new(),
            published: 0,
            calls: Calls::default(),
            linked: 0,
            last_taken: 0,
            lost: 0,
            ended: VecDeque::new(),
            ended_sum: Counters::default(),
            farewells: Vec::new(),
            gone: Vec::new(),
        }
    }

    pub(crate) fn links(&self) -> impl Iterator<Item = &LinkDriver> {
        self.links.values()
    }

    pub(crate) fn link(&self, token: u64) -> Option<&LinkDriver> {
        self.links.get(&token)
    }

    /// Whether a link is being made or opened.
    pub(crate) fn is_opening(&self) -> bool {
        // DECLARED says how many LINK frames follow it (SM2-IFC-002).
        let announced = match self.state {
            State::Live { matches } => matches,
            State::Declaring | State::Refused(_) => 0,
        };
        self.linked < announced
            || self
                .links()
                .any(|link| link.end().is_none() && !link.is_open())
    }

    /// There is no Manager any more that could make one.
    pub(super) const fn expect_no_links(&mut self) {
        self.linked = u32::MAX;
    }

    /// How many links are open.
    pub(crate) fn open_links(&self) -> usize {
        self.links().filter(|link| link.is_open()).count()
    }

    /// Which forms the open links need, and those that will open and be given what is latched.
    pub(crate) fn needs(&self) -> Needs {
        let mut needs = Needs::default();
        for link in self.links().filter(|link| link.is_open()) {
            needs.add(link.is_sealed());
        }
        if needs.nobody() && self.latches() > 0 {
            needs.add(self.contract.sealed());
        }
        needs
    }

    fn latches(&self) -> usize {
        match &self.contract {
            Contract::Publisher { offer, .. } => usize::from(offer.latched),
            _ => 0,
        }
    }

    // ---- links ----

    pub(super) fn add_link(&mut self, token: u64, link: LinkDriver, tools: &mut Tools<'_>) {
        self.links.insert(token, link);
        self.with_link(token, tools, |link, outbox, tools| {
            link.start(tools.epoll, outbox)
        });
    }

    pub(super) fn on_event(&mut self, token: u64, event: Event, tools: &mut Tools<'_>) {
        self.with_link(token, tools, |link, outbox, tools| {
            link.on_event(event, tools, outbox)
        });
    }

    pub(super) fn unlink(&mut self, id: LinkId, code: Code, tools: &mut Tools<'_>) {
        let found = self
            .links
            .iter()
            .find(|(_, link)| link.id == id && !link.buried);
        if let Some((&token, _)) = found {
            self.with_link(token, tools, |link, outbox, tools| {
                link.unlink(code, tools, outbox)
            });
        }
    }

    /// Ends all links. What their sockets took reaches the other sides.
    pub(super) fn close(&mut self, tools: &mut Tools<'_>) {
        for link in self.links.values_mut() {
            let farewell = Input::Close(Farewell::Done.code());
            link.feed(farewell, tools.epoll, &mut self.outbox);
        }
    }

    pub(super) fn tokens(&self) -> impl Iterator<Item = u64> {
        self.links.keys().copied()
    }

    /// Does what follows from a change of a link: replays what is latched, hands out
    /// replies, retires segments, buries it. Called whenever a link was fed.
    fn settle_link(&mut self, token: u64, tools: &mut Tools<'_>) {
        self.replay(token, tools);
        let Some(link) = self.links.get_mut(&token) else {
            return;
        };
        self.calls.collect(token, link, tools, &mut self.outbox);
        if link.end().is_some() && !link.buried {
            self.bury(token);
        }
        self.detach_segments(tools);
        if self
            .links
            .get(&token)
            .is_some_and(|it| it.buried && it.ready() == 0)
        {
            self.links.remove(&token);
            self.gone.push(token);
        }
    }

    /// Sends what is latched on a link that has just opened, before all else; a reliable link
    /// gets as much at a time as it has room for.
    //= SM2-QOS-003
    fn replay(&mut self, token: u64, tools: &mut Tools<'_>) {
        let Some(link) = self.links.get_mut(&token).filter(|link| link.is_open()) else {
            return;
        };
        if !link.greeted {
            link.greeted = true;
            for &key in &self.latched {
                self.outbox.hold(key);
                link.backlog.push_back(key);
            }
        }
        while let Some(&key) = link.backlog.front() {
            if link.is_reliable() && !link.has_room_for_backlog() {
                break;
            }
            link.backlog.pop_front();
            link.send(key, Status::Ok, tools.epoll, &mut self.outbox);
            self.outbox.release(key);
        }
    }

    /// A link is over: the Manager is to know, and its counters are to be kept.
    fn bury(&mut self, token: u64) {
        let Some(link) = self.links.get_mut(&token) else {
            return;
        };
        link.buried = true;
        for key in link.backlog.drain(..) {
            self.outbox.release(key);
        }
        if let Some(code) = link.farewell() {
            self.farewells.push((link.id, code));
        }
        let status = LinkStatus::of(link);
        add(&mut self.ended_sum, &status.counters);
        if self.ended.len() == HISTORY {
            self.ended.pop_front();
        }
        self.ended.push_back(status);
        self.drop_oldest_messages();
    }

    /// An application that never takes its messages must not collect those of every
    /// publisher that ever was.
    fn drop_oldest_messages(&mut self) {
        let buried = self.links.values().filter(|link| link.buried).count();
        let mut surplus = buried.saturating_sub(ENDED_WITH_MESSAGES);
        let (lost, gone) = (&mut self.lost, &mut self.gone);
        self.links.retain(|token, link| {
            let drop = link.buried && surplus > 0;
            if drop {
                surplus -= 1;
                *lost += link.ready() as u64;
                gone.push(*token);
            }
            !drop
        });
    }

    /// Tells all links of segments that are over.
    pub(crate) fn detach_segments(&mut self, tools: &mut Tools<'_>) {
        while let Some(segment) = self.outbox.over.pop() {
            for link in self.links.values_mut().filter(|link| link.end().is_none()) {
                link.feed(Input::Retire { segment }, tools.epoll, &mut self.outbox);
            }
        }
    }

    // ---- publishing ----

    /// Offers a message to every open link. What is left to do is in the result; its
    /// `key` must be [finished](Self::finish).
    pub(crate) fn publish(
        &mut self,
        forms: Forms,
        mut label: Label,
        tools: &mut Tools<'_>,
    ) -> Offered {
        self.published += 1;
        label.id = self.published;
        if forms.is_empty() {
            return Offered::default();
        }
        let key = self.outbox.store(forms, label);
        self.latch(key);
        let mut offered = Offered {
            key,
            links: 0,
            missed: 0,
            waiting: Vec::new(),
        };
        for (&token, link) in &mut self.links {
            if !link.is_open() {
                continue;
            }
            //= SM2-QOS-002
            // Those with room first; one that was waited for in vain is not waited for again.
            if !link.is_reliable() || link.has_room() {
                link.send(key, Status::Ok, tools.epoll, &mut self.outbox);
                offered.links += 1;
            } else if link.is_stalled() {
                link.skip(tools.epoll, &mut self.outbox);
                offered.missed += 1;
            } else {
                offered.waiting.push(token);
            }
        }
        self.detach_segments(tools);
        offered
    }

    /// Sends to the links that have room by now; whether none is left to wait for.
    pub(crate) fn publish_more(&mut self, offered: &mut Offered, tools: &mut Tools<'_>) -> bool {
        let (key, links) = (offered.key, &mut offered.links);
        offered.waiting.retain(|token| {
            let Some(link) = self.links.get_mut(token).filter(|link| link.is_open()) else {
                return false;
            };
            let room = link.has_room();
            if room {
                link.send(key, Status::Ok, tools.epoll, &mut self.outbox);
                *links += 1;
            }
            !room
        });
        offered.waiting.is_empty()
    }

    /// Takes back what was stored for a message that is not sent.
    pub(crate) fn drop_forms(&mut self, forms: Forms, tools: &mut Tools<'_>) {
        if let Some(lease) = forms.pooled {
            self.outbox.unlease(lease);
            self.detach_segments(tools);
        }
    }

    /// The waiting is over: links that are left go without this message.
    pub(crate) fn finish(&mut self, mut offered: Offered, tools: &mut Tools<'_>) -> Published {
        self.publish_more(&mut offered, tools);
        for token in offered.waiting.drain(..) {
            if let Some(link) = self.links.get_mut(&token) {
                link.skip(tools.epoll, &mut self.outbox);
                offered.missed += 1;
            }
        }
        self.outbox.release(offered.key);
        self.bury_ended(tools);
        Published {
            links: offered.links,
            missed: offered.missed,
        }
    }

    fn latch(&mut self, key: u64) {
        if self.latches() == 0 {
            return;
        }
        self.outbox.hold(key);
        self.latched.push_back(key);
        if self.latched.len() > self.latches()
            && let Some(oldest) = self.latched.pop_front()
        {
            self.outbox.release(oldest);
        }
    }

    /// Links that ended while they were sent to.
    pub(super) fn bury_ended(&mut self, tools: &mut Tools<'_>) {
        let ended = |(token, link): (&u64, &LinkDriver)| {
            (link.end().is_some() && !link.buried).then_some(*token)
        };
        let tokens: Vec<u64> = self.links.iter().filter_map(ended).collect();
        for token in tokens {
            self.settle_link(token, tools);
        }
        self.detach_segments(tools);
    }

    // ---- receiving ----

    /// The next message of any link, in turn.
    pub(crate) fn take(&mut self, tools: &mut Tools<'_>) -> Result<Option<Taken>, NotTaken> {
        let start = self.last_taken;
        let (mut position, mut wrapped, mut full) = (start, false, None);
        loop {
            let end = if wrapped { Included(start) } else { Unbounded };
            let mut links = self.links.range((Excluded(position), end));
            match links.find(|(_, link)| link.ready() > 0) {
                Some((&token, _)) => {
                    position = token;
                    match self.take_from(token, tools) {
                        Err(NotTaken::TooManyBorrowed(error, peer)) => full = Some((error, peer)),
                        result => return result,
                    }
                }
                None if wrapped => break,
                // Tokens of links are greater than zero.
                None => (position, wrapped) = (0, true),
            }
        }
        match full {
            Some((error, peer)) => Err(NotTaken::TooManyBorrowed(error, peer)),
            None => Ok(None),
        }
    }

    fn take_from(&mut self, token: u64, tools: &mut Tools<'_>) -> Result<Option<Taken>, NotTaken> {
        let Some(link) = self.links.get_mut(&token) else {
            return Ok(None);
        };
        let peer = Arc::clone(&link.peer);
        let taken = link.take();
        let result = match taken {
            Ok(None) => Ok(None),
            Ok(Some((delivery, payload))) => {
                self.last_taken = token;
                self.lost += delivery.lost;
                Ok(Some(Taken {
                    token,
                    peer,
                    delivery,
                    payload,
                }))
            }
            Err(TakeError::TooManyBorrowed(error)) => {
                return Err(NotTaken::TooManyBorrowed(error, peer));
            }
            Err(TakeError::Map {
                sequence, error, ..
            }) => {
                self.lost += 1;
                link.release(sequence, tools.epoll, &mut self.outbox);
                let code = Farewell::Resources.code();
                link.feed(Input::Close(code), tools.epoll, &mut self.outbox);
                Err(NotTaken::Map(error, peer))
            }
        };
        self.settle_link(token, tools);
        result
    }

    /// Changes one link, if it is there, and does what follows from it.
    pub(super) fn with_link<R>(
        &mut self,
        token: u64,
        tools: &mut Tools<'_>,
        change: impl FnOnce(&mut LinkDriver, &mut Outbox, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        let link = self.links.get_mut(&token)?;
        let result = change(link, &mut self.outbox, tools);
        self.settle_link(token, tools);
        Some(result)
    }

    // ---- accounts ----

    /// All links, those that ended first.
    pub(crate) fn statuses(&self) -> Vec<LinkStatus> {
        let live = self.links().filter(|link| !link.buried).map(LinkStatus::of);
        self.ended.iter().cloned().chain(live).collect()
    }

    /// The sum over all links that ever were.
    //= SM2-QOS-004
    pub(crate) fn counters(&self) -> Counters {
        let mut sum = self.ended_sum;
        for link in self.links().filter(|link| !link.buried) {
            add(&mut sum, &link.counters());
        }
        sum
    }
}

/// A message that was published, but not sent to all links yet.
#[derive(Debug, Default)]
pub(crate) struct Offered {
    key: u64,
    links: usize,
    missed: usize,
    /// Reliable links without room.
    pub(crate) waiting: Vec<u64>,
}

/// A message that the application holds.
#[derive(Debug)]
pub(crate) struct Taken {
    pub(crate) token: u64,
    pub(crate) peer: Arc<Peer>,
    pub(crate) delivery: Delivery,
    pub(crate) payload: Payload,
}

/// Why there is no message, although one is there.
#[derive(Debug)]
pub(crate) enum NotTaken {
    TooManyBorrowed(TooManyBorrowed, Arc<Peer>),
    Map(std::io::Error, Arc<Peer>),
}

impl LinkStatus {
    fn of(link: &LinkDriver) -> Self {
        Self {
            id: link.id,
            peer: Arc::clone(&link.peer),
            open: link.is_open(),
            reliable: link.is_reliable(),
            sealed: link.is_sealed(),
            counters: link.counters(),
            end: link.end(),
        }
    }
}

fn add(sum: &mut Counters, more: &Counters) {
    sum.offered += more.offered;
    sum.delivered += more.delivered;
    sum.overwritten += more.overwritten;
    sum.discarded += more.discarded;
    sum.deadline += more.deadline;
    sum.closed += more.closed;
    sum.in_flight += more.in_flight;
}
