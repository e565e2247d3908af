//! Work in parts, so that no input occupies the Manager for long (SM2-SES-009).
//!
//! | work | begins with | where the next part begins |
//! | --- | --- | --- |
//! | to link an interface, or those of a resumption | DECLARE, CLAIMED | `Matching` of the session |
//! | to end links | WITHDRAW, the end of a session | `EndingLinks` |
//! | to give up claims | their deadline | `Manager::expired`, and the claims that are left |
//! | to announce links | room in a socket | `PendingLinks` |
//! | to make links again | the deadline after a shortage of descriptors | `Shortage` |
//! | to apply another access policy | its input | `Reload` |
//!
//! A session with unfinished work is *busy*. Its further frames wait in its socket, so a session has
//! at most one unfinished frame. Of the sessions with unfinished work, the one that has used least goes next; see
//! [`FairQueue`](super::fair_queue::FairQueue).

use super::{
    Manager,
    budget::{Budget, MARK, PAIR, UNLINK},
    session::Session,
};
use crate::{EntityId, Farewell, Instant, NodeId};

impl Manager {
    /// Whether the work of a session's last frame is unfinished. The driver leaves the session's
    /// further frames in its socket, and feeds [`Input::Tick`](super::Input::Tick) at the deadline
    /// until the work is done. A frame that is fed regardless first finishes the work, however much
    /// it is.
    //= SM2-SES-009
    #[must_use]
    pub fn is_busy(&self, node: NodeId) -> bool {
        let session = self.registry.sessions().get(node);
        session.is_some_and(Session::is_matching)
            || self.expired.contains(&node)
            || self.registry.ending_links.has(node)
    }

    /// Does one part of the deferred work: of the links that could not be made, of one session with
    /// pending links that has room, and of the busy one that has used least.
    pub(super) fn run_deferred(&mut self, now: Instant) {
        if self.is_policy_due(now) {
            self.apply_policy(now);
        }
        if self.shortage.is_due(now) {
            self.link_again();
        }
        if let Some((node, after)) = self.registry.pending_links.next_announceable() {
            self.announce_pending(node, after);
        }
        if let Some(node) = self.jobs.next() {
            self.work(node, &mut Budget::new(&self.limits));
        }
    }

    /// Whether deferred work can be done now.
    pub(super) fn has_deferred(&self, now: Instant) -> bool {
        self.registry.pending_links.has_announceable()
            || !self.jobs.is_empty()
            || self.shortage.is_due(now)
            || self.is_policy_due(now)
    }

    /// Finishes the work of the session's last frame.
    pub(super) fn finish(&mut self, node: NodeId) {
        while self.is_busy(node) {
            self.work(node, &mut Budget::unlimited());
        }
    }

    /// Finishes the work of all sessions.
    pub(super) fn finish_all(&mut self) {
        while let Some(node) = self.jobs.next() {
            self.finish(node);
            self.jobs.remove(node);
        }
    }

    /// Goes on with the unfinished work of a session. The session waits for its next turn if some
    /// is left.
    //= SM2-SES-009
    pub(super) fn work(&mut self, node: NodeId, budget: &mut Budget) {
        let before = budget.left();
        self.end_links(node, budget);
        self.give_up_expired(node, budget);
        self.match_interfaces(node, budget);
        let is_busy = self.is_busy(node);
        if is_busy {
            self.jobs.insert(node);
        }
        self.jobs.charge(node, before - budget.left());
        if is_busy {
            // It waits for its next part.
        } else if self.registry.sessions().get(node).is_some() {
            self.jobs.remove(node);
        } else {
            self.jobs.forget(node);
        }
    }

    /// Ends links of interfaces that are gone, and forgets why others were not linked.
    fn end_links(&mut self, node: NodeId, budget: &mut Budget) {
        while !budget.is_spent()
            && let Some((entity, cause)) = self.registry.ending_links.first_of(node)
        {
            if let Some((link, pair)) = self.registry.ending_links.pop(entity) {
                budget.spend(UNLINK);
                self.end_link(link, pair, entity, cause.code());
            } else if !self.forget_pair(entity, budget) {
                budget.spend(PAIR);
                self.registry.complete_end(entity);
            }
        }
    }

    /// Forgets one pair of an interface that is gone or suspended. Returns whether there was one.
    pub(super) fn forget_pair(&mut self, entity: EntityId, budget: &mut Budget) -> bool {
        let forgotten = self.registry.forget_unlinked(entity) || self.shortage.forget_one(entity);
        if forgotten {
            budget.spend(MARK);
        }
        forgotten
    }

    /// Gives up claims whose counterparts did not come in time.
    //= SM2-RES-006
    fn give_up_expired(&mut self, node: NodeId, budget: &mut Budget) {
        while !budget.is_spent() && self.expired.contains(&node) {
            let record = self.registry.sessions().record(node);
            let Some((interface, link)) = record.and_then(|it| it.half_claims().next()) else {
                self.expired.remove(&node);
                return;
            };
            budget.spend(UNLINK);
            let entity = EntityId { node, interface };
            self.registry.give_up_claim(entity, link);
            self.begin_unlink(entity, link, Farewell::PeerGone.code());
        }
    }

    /// Links the interfaces of a session with their matches.
    //= SM2-RES-007, SM2-MAT-002
    fn match_interfaces(&mut self, node: NodeId, budget: &mut Budget) {
        while !budget.is_spent()
            && let Some(session) = self.registry.session_mut(node)
            && let Some((entity, after)) = session.next_to_match(node)
        {
            let (links, more) = self.link_missing(entity, after, budget);
            if let Some(session) = self.registry.session_mut(node) {
                session.matched(entity.interface, more);
            }
            self.outbox.extend(links);
        }
    }

    /// Whether exactly the busy sessions wait for their turn.
    pub(super) fn jobs_agree(&self) -> bool {
        let sessions = self.registry.sessions().iter();
        let matching = sessions.filter(|(_, it)| it.is_matching());
        let matching = matching.map(|(node, _)| node);
        let expired = self.expired.iter().copied();
        let mut busy = matching
            .chain(expired)
            .chain(self.registry.ending_links.nodes());
        self.jobs.iter().all(|it| self.is_busy(it)) && busy.all(|it| self.jobs.contains(it))
    }
}
