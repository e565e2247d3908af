//! The QoS of a topic's link: ticks for the deadline and the lease, messages that are older than their lifespan, and
//! the account of messages that were published while there was no link.

use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Account, Delivery, Input, Publications, Record};
use sm2_proto::{Contract, Farewell, Instant, Machine, Period, QosWatch};

use super::LinkDriver;
use crate::driver::context::Context;
use crate::driver::counters::update;
use crate::driver::outbox::Outbox;

impl LinkDriver {
    /// The time of the next tick, if there is one.
    pub(in crate::driver) fn deadline(&self) -> Option<Instant> {
        self.machine.deadline()
    }

    /// Subscriber: counts the periods that have passed without a message, and checks whether the publisher is alive.
    /// On the socket lane the messages may wait in the socket; ALIVE does so on both lanes. Publisher: sends ALIVE that
    /// was held back.
    //= SM2-QOS-009, SM2-QOS-011, SM2-QOS-012
    pub(in crate::driver) fn tick(&mut self, context: &mut Context<'_>, outbox: &mut Outbox) {
        if self.deadline().is_none_or(|due| context.now < due) {
            return;
        }
        self.receive_all(context, outbox);
        self.tick_machine(context.now);
        self.drain_idle(context.sets, outbox);
    }

    fn tick_machine(&mut self, now: Instant) {
        let tick = Input::Tick(self.machine.newest(&self.mapped));
        // A link that is over does not tick.
        let _ = self.machine.handle(now, tick);
    }

    /// How the publisher at the other end of a subscriber's link keeps its deadline and its lease.
    pub(in crate::driver) const fn qos_watch(&self) -> &QosWatch {
        self.machine.watch()
    }

    /// How many more periods have passed without a message than at the last call.
    pub(in crate::driver) fn take_missed(&mut self) -> u64 {
        let more = self.machine.watch_mut().take_missed();
        if more > 0 {
            update(self.counting.entry.as_mut(), |entry| {
                entry.missed_deadlines(more)
            });
        }
        more
    }

    /// Whether the publisher is alive, if that has changed since the last call.
    #[inline]
    pub(in crate::driver) fn take_liveliness_change(&mut self) -> Option<bool> {
        let change = self.machine.watch_mut().take_liveliness_change();
        if change == Some(false) {
            update(self.counting.entry.as_mut(), |entry| {
                entry.lost_liveliness()
            });
        }
        change
    }

    /// Gives a message back that is older than its lifespan. The next message reports what was lost before this one.
    //= SM2-QOS-010
    #[cold]
    pub(super) fn drop_taken(
        &mut self,
        delivery: &Delivery<()>,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        self.account.expire(delivery, self.counting.entry.as_mut());
        self.lost_with_expired = self.lost_with_expired.saturating_add(delivery.lost);
        self.received.expired += 1;
        update(self.counting.entry.as_mut(), |entry| entry.expired(1));
        self.kept.remove(&delivery.sequence);
        let wake = self.machine.expire(&self.mapped, delivery);
        self.wake(wake.unwrap_or_default(), context.sets);
        self.drain_if_due(context.sets, outbox);
    }

    /// Whether a message of the backlog with this time is older than its lifespan.
    pub(in crate::driver) fn is_expired(&self, time: Instant) -> bool {
        self.machine.is_expired(time, sm2_io::clock::now)
    }

    /// Drops the messages that wait for the window and are older than their lifespan.
    //= SM2-QOS-010
    #[inline]
    pub(super) fn expire_unsent(&mut self, context: &Context<'_>, outbox: &mut Outbox) {
        let may_expire =
            self.machine.config().lifespan != Period::NONE && self.machine.has_queued();
        if may_expire {
            self.tick_machine(sm2_io::clock::now());
            self.drain_idle(context.sets, outbox);
        }
    }

    /// The publications that the publisher of a subscriber's link states, until the account is open.
    #[inline]
    pub(in crate::driver) fn publications_to_account(&self) -> Option<Publications> {
        let publications = self.machine.peer_publications();
        (!publications.is_unknown() && self.account.account.is_none()).then_some(publications)
    }

    /// Whether the messages of this link, which is over, have to be taken before those of a link with this publisher.
    pub(in crate::driver) fn precedes(&self, peer: &LinkPeer, of: Publications) -> bool {
        self.end().is_some()
            && self.machine.peer_publications().publisher == of.publisher
            && self.origin.peer.name == peer.name
    }

    /// Takes no message from this link until those of an older link are taken, or takes them now.
    pub(in crate::driver) const fn wait_for_older(&mut self, waits: bool) {
        self.account.waits_for_older = waits;
    }

    /// Whether messages of an older link come first.
    #[inline]
    pub(in crate::driver) const fn waits_for_older(&self) -> bool {
        self.account.waits_for_older
    }

    /// Opens the account. Returns how many messages were published while the publisher had no link, and counts them for
    /// this link.
    //= SM2-QOS-013
    pub(in crate::driver) fn open_account(
        &mut self,
        publications: Publications,
        record: Option<Record>,
    ) -> u64 {
        let is_latched = match &self.origin.peer.contract {
            Contract::Publisher { offer, .. } => offer.latched > 0,
            _ => false,
        };
        let (account, away) = Account::open(publications, is_latched, record);
        self.account.account = Some(account);
        self.account.unsettled = true;
        self.account.add_away(away, self.counting.entry.as_mut());
        away
    }

    /// Ends the account of a link that is removed. Returns what is remembered of its publisher: nothing if the
    /// publisher is gone. `dropped` messages of the link were counted as lost.
    //= SM2-QOS-013
    pub(in crate::driver) fn close_account(&self, dropped: u64) -> Option<(u64, Record)> {
        let is_gone = self.end_code() == Some(Farewell::Done.code());
        let account = self.account.account.filter(|_| !is_gone)?;
        let (lost, away) = self.not_counted();
        let last_id = (self.account.last_id > 0).then_some(self.account.last_id);
        let publisher = self.machine.peer_publications().publisher;
        Some((
            publisher,
            account.close(last_id, dropped, lost.saturating_add(away)),
        ))
    }

    /// The losses before messages that have expired and that no later message has reported: on the link, and while the
    /// publisher had no link.
    pub(in crate::driver) const fn not_counted(&self) -> (u64, u64) {
        match self.account.unsettled {
            true => self.account.with_expired,
            false => (self.lost_with_expired, 0),
        }
    }
}
