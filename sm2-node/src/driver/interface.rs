//! One declared interface: its links, its outgoing messages, and its calls.

use std::collections::VecDeque;

use sm2_io::{CounterEntry, Event};
use sm2_proto::link::{Counters, Input};
use sm2_proto::{Code, Contract, Farewell, LinkId, Name, Refusal};

use super::calls::Calls;
use super::link::{LinkDriver, Tools};
use super::links::Links;
use super::message_key::MessageKey;
use super::outbox::Outbox;
use super::status::LinkStatus;
use super::token::LinkToken;

/// How many ended links are listed one by one; older ones are only added to the sums.
const HISTORY: usize = 64;
/// How many ended links may still hold messages that the application has not taken.
const ENDED_WITH_MESSAGES: usize = 64;

#[derive(Debug)]
pub(crate) struct Interface {
    pub(crate) contract: Contract,
    pub(crate) state: State,
    pub(super) links: Links,
    pub(crate) outbox: Outbox,
    /// Keys of the last messages, the oldest first.
    pub(super) latched: VecDeque<MessageKey>,
    /// The number of published messages.
    pub(super) published: u64,
    pub(super) calls: Calls,
    /// Whether a client may call the server of the node with this name.
    pub(crate) servers: fn(&Name) -> bool,
    /// How many LINKs that DECLARED announced have not come yet (SM2-IFC-002).
    pub(super) links_due: u32,
    /// The reason why the Manager of this session refused the interface, although an earlier
    /// Manager had granted it.
    pub(super) refused_again: Option<Refusal>,
    /// The entry of its counters.
    pub(super) entry: Option<CounterEntry>,
    /// The link from which the last message was taken.
    pub(super) last_taken: LinkToken,
    /// How many publications the application misses, as far as the node knows.
    pub(crate) lost: u64,
    pub(super) ended: VecDeque<LinkStatus>,
    pub(super) ended_sum: Counters,
    /// Ended links that the Manager has to be told about.
    pub(super) farewells: Vec<(LinkId, Code)>,
    /// Tokens of links that were removed.
    pub(super) gone: Vec<LinkToken>,
}

/// The progress of the declaration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Declaring,
    Live { matches: u32 },
    Refused(Refusal),
}

impl Interface {
    pub(super) fn new(
        contract: Contract,
        pool_limit_bytes: u64,
        entry: Option<CounterEntry>,
    ) -> Self {
        Self {
            contract,
            state: State::Declaring,
            links: Links::default(),
            outbox: Outbox::new(pool_limit_bytes),
            latched: VecDeque::new(),
            published: 0,
            calls: Calls::default(),
            servers: |_| true,
            links_due: 0,
            refused_again: None,
            entry,
            last_taken: LinkToken::FIRST,
            lost: 0,
            ended: VecDeque::new(),
            ended_sum: Counters::default(),
            farewells: Vec::new(),
            gone: Vec::new(),
        }
    }

    pub(crate) fn links(&self) -> impl Iterator<Item = &LinkDriver> {
        self.links.iter()
    }

    pub(crate) fn link(&self, token: LinkToken) -> Option<&LinkDriver> {
        self.links.get(token)
    }

    /// Whether a link is announced or being opened.
    pub(crate) fn is_opening(&self) -> bool {
        self.links_due > 0
            || self
                .links()
                .any(|link| link.end().is_none() && !link.is_open())
    }

    /// Whether the Manager of this session has granted the interface. Meaningful once that Manager
    /// knows all interfaces of the node.
    pub(super) fn is_granted(&self) -> bool {
        matches!(self.state, State::Live { .. }) && self.refused_again.is_none()
    }

    /// The number of open links.
    pub(crate) fn open_links(&self) -> usize {
        self.links().filter(|link| link.is_open()).count()
    }

    pub(super) fn add_link(&mut self, link: LinkDriver, tools: &mut Tools<'_>) {
        let token = link.token();
        self.links.push(link);
        self.with_link(token, tools, |link, outbox, tools| {
            link.start(tools.epoll, outbox)
        });
    }

    pub(super) fn on_event(&mut self, token: LinkToken, event: Event, tools: &mut Tools<'_>) {
        self.with_link(token, tools, |link, outbox, tools| {
            link.on_event(event, tools, outbox)
        });
    }

    pub(super) fn unlink(&mut self, id: LinkId, code: Code, tools: &mut Tools<'_>) {
        let found = self.links.iter().find(|link| link.id == id && !link.buried);
        if let Some(token) = found.map(LinkDriver::token) {
            self.with_link(token, tools, |link, outbox, tools| {
                link.unlink(code, tools, outbox)
            });
        }
    }

    /// Closes all links. Messages that their sockets have accepted still reach the other sides.
    pub(super) fn close(&mut self, tools: &mut Tools<'_>) {
        for link in self.links.iter_mut() {
            let farewell = Input::Close(Farewell::Done.code());
            link.feed(farewell, tools.epoll, &mut self.outbox);
            tools.counting.free(link.entry.take());
        }
        tools.counting.free(self.entry.take());
    }

    /// Settles the messages that the other sides have released on the ring lane.
    pub(crate) fn harvest(&mut self, tools: &mut Tools<'_>) {
        if matches!(self.contract, Contract::Subscriber { .. }) {
            return;
        }
        let mut is_over = false;
        for link in self.links.iter_mut() {
            link.harvest(tools, &mut self.outbox);
            is_over |= link.end().is_some() && !link.buried;
        }
        // A fault in its ring has ended the link, so the Manager has to be told.
        if is_over {
            self.bury_ended(tools);
        }
        // The last message of a segment may have come back.
        self.detach_segments(tools);
    }

    /// Whether there may be a message to take.
    pub(super) fn is_ready(&self) -> bool {
        self.links.iter().any(LinkDriver::is_ready)
    }

    /// Prepares the links for a thread that is about to sleep until the interface has an event.
    pub(super) fn park(&mut self) {
        for link in self.links.iter_mut() {
            link.park();
        }
    }

    pub(super) fn tokens(&self) -> impl Iterator<Item = LinkToken> {
        self.links.iter().map(LinkDriver::token)
    }

    /// Does the work that follows from a change of a link: replays latched messages, hands out
    /// replies, retires segments, and removes the link if it has ended. Every caller that feeds a
    /// link calls this function.
    pub(super) fn settle_link(&mut self, token: LinkToken, tools: &mut Tools<'_>) {
        self.replay(token, tools);
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        self.calls.collect(token, link, tools, &mut self.outbox);
        link.send_waiting(tools, &mut self.outbox);
        link.note_fates(tools.counting);
        if link.end().is_some() && !link.buried {
            self.bury(token, tools);
        }
        self.detach_segments(tools);
        if self
            .links
            .get(token)
            .is_some_and(|it| it.buried && !it.is_ready())
        {
            self.links.remove(token);
            self.gone.push(token);
        }
    }

    /// Settles the links that ended during a send.
    pub(super) fn bury_ended(&mut self, tools: &mut Tools<'_>) {
        // Allocates only if a link has ended.
        let mut tokens = Vec::new();
        for link in self.links.iter() {
            if link.end().is_some() && !link.buried {
                tokens.push(link.token());
            }
        }
        for token in tokens {
            self.settle_link(token, tools);
        }
        self.detach_segments(tools);
    }

    /// Records the end of a link: queues it for the Manager, and keeps its counters.
    fn bury(&mut self, token: LinkToken, tools: &mut Tools<'_>) {
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        link.buried = true;
        tools.counting.free(link.entry.take());
        for key in link.backlog.drain(..) {
            self.outbox.release(key);
        }
        if let Some(code) = link.farewell() {
            self.farewells.push((link.id, code));
        }
        let status = LinkStatus::of(link);
        status.add_to(&mut self.ended_sum);
        if self.ended.len() == HISTORY {
            self.ended.pop_front();
        }
        self.ended.push_back(status);
        self.drop_oldest_messages(tools);
    }

    /// Drops the messages of the oldest ended links, so that an application that takes no messages
    /// does not collect those of all past publishers.
    fn drop_oldest_messages(&mut self, tools: &mut Tools<'_>) {
        let buried = self.links.iter().filter(|link| link.buried).count();
        let mut surplus = buried.saturating_sub(ENDED_WITH_MESSAGES);
        let (mut lost, gone) = (0, &mut self.gone);
        self.links.retain(|link| {
            let drop = link.buried && surplus > 0;
            if drop {
                surplus -= 1;
                lost += link.ready() as u64;
                gone.push(link.token());
            }
            !drop
        });
        if lost > 0 {
            self.lose(lost, tools);
        }
    }

    /// Counts messages that came and that the application will not get.
    pub(super) fn lose(&mut self, messages: u64, tools: &mut Tools<'_>) {
        self.lost += messages;
        (tools.counting).note(self.entry.as_ref(), |entry| entry.lost(messages));
    }

    /// Tells all links which segments are not used any more.
    pub(crate) fn detach_segments(&mut self, tools: &mut Tools<'_>) {
        while let Some(segment) = self.outbox.over.pop() {
            for link in self.links.iter_mut().filter(|link| link.end().is_none()) {
                link.feed(Input::Retire { segment }, tools.epoll, &mut self.outbox);
            }
        }
    }

    /// Changes one link, if it exists, and does the work that follows from the change.
    pub(super) fn with_link<R>(
        &mut self,
        token: LinkToken,
        tools: &mut Tools<'_>,
        change: impl FnOnce(&mut LinkDriver, &mut Outbox, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        let link = self.links.get_mut(token)?;
        let result = change(link, &mut self.outbox, tools);
        self.settle_link(token, tools);
        Some(result)
    }
}
