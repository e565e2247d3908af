//! One declared interface: its links, its outgoing messages, and its calls.

mod absence;
mod calls;
mod event_queue;
mod latched;
mod limit;
mod links;
mod publish;
mod qos;
mod reports;
mod road;
mod service;
mod settle;
mod take;
mod taken;

use std::sync::Arc;

use sm2_io::{CounterEntry, Event};
use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Input, MaxLen};
use sm2_proto::{Code, Contract, Farewell, Instant, LinkId, Refusal};

use self::absence::Absence;
use self::calls::Calls;
pub(crate) use self::calls::{CallId, Choice, Outcome};
use self::latched::LatchedMessages;
use self::links::{Links, QosCounts};
pub(crate) use self::publish::Offered;
use self::qos::QosMonitor;
use self::reports::Reports;
pub(crate) use self::service::CallBody;
pub(crate) use self::taken::{Full, Header, Taken};
use super::context::Context;
use super::leftovers::Leftover;
use super::link::LinkDriver;
use super::outbox::{Outbox, PoolLimit};
use super::token::LinkToken;

#[derive(Debug)]
pub(crate) struct DeclaredInterface {
    pub(crate) contract: Contract,
    /// The longest message that the interface accepts.
    pub(super) max_len: MaxLen,
    pub(crate) state: State,
    pub(crate) links: Links,
    pub(crate) outbox: Outbox,
    latched: LatchedMessages,
    /// The number of published messages.
    pub(super) published: u64,
    /// How many publications wait for reliable links.
    pub(crate) waiting: u32,
    pub(crate) calls: Calls,
    /// The reason why the Manager of this session refused the interface, although an earlier
    /// Manager had granted it.
    pub(super) refused_again: Option<Refusal>,
    /// The link that the last message was taken from.
    pub(super) last_taken: LinkToken,
    pub(super) absence: Absence,
    /// Whether the program has dropped the interface.
    is_closed: bool,
    pub(crate) reports: Reports,
    qos: QosMonitor,
    /// Results of calls that the control side has to handle.
    for_control: ForControl,
}

/// Results of calls that the control side has to handle, once the interface is not locked any more.
#[derive(Debug, Default)]
pub(crate) struct ForControl {
    /// Ended links that the Manager has to be told about.
    pub(super) ends: Vec<(LinkId, Code)>,
    /// Tokens of links that were removed.
    pub(super) gone: Vec<LinkToken>,
    /// Entries of the counters that are not used any more.
    pub(super) freed: Vec<CounterEntry>,
    /// Whether the Manager has to be asked for a PAGE.
    pub(super) wants_page: bool,
    /// When the interface has to be ticked, if that is earlier than before.
    pub(super) tick_at: Option<Instant>,
    /// Memory of messages that goes back to the system.
    pub(super) leftovers: Vec<Leftover>,
}

impl ForControl {
    #[inline]
    fn is_empty(&self) -> bool {
        // One branch: each call asks this.
        (self.ends.len() | self.gone.len() | self.freed.len() | self.leftovers.len()) == 0
            && !self.wants_page
            && self.tick_at.is_none()
    }
}

/// The progress of the declaration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Declaring,
    Live { matches: u32 },
    Refused(Refusal),
}

/// An event of an interface that a program waits for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Condition {
    /// A message or a request may be there.
    Message,
    /// The call is over.
    Call(CallId),
    /// There is an event for the program.
    Event,
    /// A publication would not wait.
    Room,
}

impl DeclaredInterface {
    pub(super) fn new(
        contract: Contract,
        pool_limit: PoolLimit,
        max_len: MaxLen,
        entry: Option<CounterEntry>,
    ) -> Self {
        Self {
            absence: Absence::of(&contract),
            latched: LatchedMessages::of(&contract),
            qos: QosMonitor::of(&contract),
            contract,
            max_len,
            state: State::Declaring,
            links: Links::default(),
            outbox: Outbox::new(pool_limit),
            published: 0,
            waiting: 0,
            calls: Calls::default(),
            refused_again: None,
            last_taken: LinkToken::FIRST,
            is_closed: false,
            reports: Reports {
                entry,
                ..Reports::default()
            },
            for_control: ForControl::default(),
        }
    }

    /// Whether the Manager of this session has granted the interface. Meaningful once that Manager
    /// knows all interfaces of the node.
    pub(super) fn is_granted(&self) -> bool {
        matches!(self.state, State::Live { .. }) && self.refused_again.is_none()
    }

    /// Whether there are results of calls that the control side has to handle.
    #[inline]
    pub(super) fn has_for_control(&self) -> bool {
        !self.for_control.is_empty() || !self.outbox.leftovers.is_empty()
    }

    /// Takes the results of calls that the control side has to handle, if there are any.
    pub(super) fn take_for_control(&mut self) -> Option<ForControl> {
        if !self.outbox.leftovers.is_empty() {
            self.for_control
                .leftovers
                .append(&mut self.outbox.leftovers);
        }
        (!self.for_control.is_empty()).then(|| std::mem::take(&mut self.for_control))
    }

    /// Whether a link has ended that the control side does not know of.
    #[inline]
    pub(super) fn has_ended_links(&self) -> bool {
        !self.for_control.ends.is_empty()
    }

    /// The Manager of this session refused the interface, although an earlier Manager or access policy had granted it.
    //= SM2-RES-010, SM2-ACC-013
    pub(super) fn refuse_again(&mut self, reason: Refusal) {
        let (kind, name) = (self.contract.kind(), self.contract.name());
        match reason.is_denial() {
            _ if self.refused_again.is_some() => {}
            true => {
                tracing::warn!(%kind, %name, %reason, "this interface lost its rights: its links end");
            }
            false => tracing::warn!(
                %kind, %name, %reason,
                "the new Manager refused this interface: its links stay open, but it gets no new ones"
            ),
        }
        self.refused_again = Some(reason);
    }

    pub(super) fn add_link(&mut self, link: LinkDriver, context: &mut Context<'_>) {
        let token = link.token();
        self.links.push(link);
        self.with_link(token, context, |link, outbox, context| {
            link.start(context.sets, outbox)
        });
    }

    pub(super) fn on_event(&mut self, token: LinkToken, event: Event, context: &mut Context<'_>) {
        self.with_link(token, context, |link, outbox, context| {
            link.on_event(event, context, outbox)
        });
    }

    /// Called when the background thread has handled an event of a link.
    pub(super) fn after_background_event(&mut self, token: LinkToken, context: &mut Context<'_>) {
        if let Some(link) = self.links.get_mut(token) {
            link.after_background_event(context.sets);
        }
    }

    /// Ends a link for the Manager. A denied link may have ended before.
    pub(super) fn unlink(&mut self, id: LinkId, code: Code, context: &mut Context<'_>) {
        let is_denied = code == Farewell::Denied.code();
        let mut links = self.links.iter();
        let found = links.find(|link| link.id == id && (is_denied || !link.end_noticed));
        let token = found.map(LinkDriver::token);
        drop(links);
        // The other side may map all segments, even if its link has ended before.
        if is_denied {
            self.outbox.replace_segments();
        }
        if let Some(token) = token {
            self.with_link(token, context, |link, outbox, context| {
                link.unlink(code, context, outbox)
            });
        }
    }

    /// Closes all links, because the program has dropped the interface. Messages that their sockets have accepted
    /// still reach the other sides.
    pub(super) fn close(&mut self, context: &mut Context<'_>) {
        self.is_closed = true;
        for link in self.links.iter_mut() {
            let close = Input::Close(Farewell::Done.code());
            link.feed(close, context.sets, &mut self.outbox);
            self.for_control.freed.extend(link.counting.entry.take());
        }
        self.for_control.freed.extend(self.reports.entry.take());
    }

    /// Whether the program would find what it waits for.
    pub(crate) fn is_ready(&mut self, condition: Condition, context: &mut Context<'_>) -> bool {
        match condition {
            _ if self.is_closed => false,
            Condition::Message => self.links.may_take(),
            Condition::Call(call) => self.is_call_over(call, context),
            Condition::Event => self.reports.events.has_any(),
            Condition::Room => self.has_room(),
        }
    }

    /// How a publisher, or the publishers of a subscriber, have kept their deadlines and leases.
    pub(crate) fn qos_counts(&self) -> QosCounts {
        self.qos.counts(&self.links)
    }

    /// Counts messages of this publisher that came and that the application will not get.
    pub(crate) fn lose(&mut self, publisher: &Arc<LinkPeer>, messages: u64) {
        self.reports.lose(publisher, messages, 0);
    }

    /// Changes one link, if it exists, and does the work that follows from the change.
    pub(super) fn with_link(
        &mut self,
        token: LinkToken,
        context: &mut Context<'_>,
        change: impl FnOnce(&mut LinkDriver, &mut Outbox, &mut Context<'_>),
    ) {
        if let Some(link) = self.links.get_mut(token) {
            change(link, &mut self.outbox, context);
            self.settle_link(token, context);
        }
    }
}

#[cfg(test)]
mod tests {
    use sm2_io::CounterPage;
    use sm2_proto::InterfaceId;

    use super::*;

    /// Each kind of result alone, and two kinds with as many results, are handled by the control side.
    #[test]
    fn every_result_is_one_for_the_control_side() {
        let mut page = CounterPage::new().expect("a page");
        let mut entry = || {
            page.allocate(InterfaceId(1), None, Instant(0))
                .expect("an entry")
        };
        let file = || Leftover::File(std::fs::File::open("/dev/null").expect("a file").into());
        let link = LinkId {
            epoch: 1,
            serial: 1,
        };
        let of = |kinds: [bool; 4], entry: Option<CounterEntry>| ForControl {
            ends: Vec::from_iter(kinds[0].then_some((link, Code(1)))),
            gone: Vec::from_iter(kinds[1].then_some(LinkToken::FIRST.next())),
            freed: Vec::from_iter(entry),
            leftovers: Vec::from_iter(kinds[3].then(file)),
            ..ForControl::default()
        };
        for number in 0_u8..16 {
            let kinds = [0, 1, 2, 3].map(|bit| number & 1 << bit != 0);
            let entry = kinds[2].then(&mut entry);
            assert_eq!(of(kinds, entry).is_empty(), number == 0, "{kinds:?}");
        }
        let page = ForControl {
            wants_page: true,
            ..ForControl::default()
        };
        let tick = ForControl {
            tick_at: Some(Instant(1)),
            ..ForControl::default()
        };
        assert!(!page.is_empty() && !tick.is_empty());
    }
}
