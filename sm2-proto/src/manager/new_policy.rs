//! Another access policy for a domain that runs (SM2-ACC-013, SM2-ACC-014).
//!
//! | pass | on each interface, in ascending order |
//! | --- | --- |
//! | [`Pass::Deny`] | suspends it if the policy denies it, and ends the links of suspended ones |
//! | [`Pass::Allow`] | ends its suspension if the policy allows it, and links it with its matches |
//!
//! The second pass begins when the first has seen all interfaces, so a topic with one publisher is
//! free for another one if the policy denies the publisher that it had. The policy is applied once
//! both passes are over and the nodes have confirmed the ends of their links.
//!
//! A suspended interface stays declared, so it comes back without help of the program. It is on no channel, so
//! matching, types and exclusive topics need no exception for it.

use alloc::sync::Arc;

use super::{
    Cause, Manager,
    budget::{Budget, MARK, PAIR, UNLINK},
    links::Pair,
    reload::Pass,
};
use crate::{
    Contract, EntityId, Farewell, Instant, InterfaceId, Kind, LinkId, NodeId, Refusal,
    control::{Limit, ToNode},
    policy::AccessPolicy,
};

impl Manager {
    /// Whether the last [`Input::SetAccessPolicy`](super::Input::SetAccessPolicy) is still being
    /// applied. When this is false, no node delivers a message of a link that the policy denies.
    //= SM2-ACC-014
    #[must_use]
    pub fn is_applying_policy(&self) -> bool {
        !self.reload.is_over()
    }

    /// Judges all that is new by the policy from now on, and the rest in parts.
    //= SM2-ACC-013
    pub(super) fn set_access_policy(&mut self, policy: Option<Arc<AccessPolicy>>) {
        let is_missing = policy.is_none() && !self.has_access_policy();
        self.registry.set_policy(policy);
        self.reload_requests
            .policy_was_read(is_missing, &mut self.outbox);
        self.reload.begin();
    }

    /// Does one part of the work: of a pass, or the end of one session.
    //= SM2-SES-009
    pub(super) fn apply_policy(&mut self, now: Instant) {
        let mut budget = Budget::new(&self.limits);
        while !budget.is_spent()
            && let Some(pass) = self.reload.pass
        {
            self.reload.pass = match pass {
                Pass::Deny(at) => Some(self.deny(at, &mut budget)),
                Pass::Allow(at, after) => self.allow(at, after, &mut budget),
            };
            if self.reload.pass.is_none() {
                self.reload.until = Some(now.after(self.limits.time(Limit::Confirmation)));
            }
        }
        if self.reload.pass.is_none()
            && let Some((node, why)) = self.next_end(now)
        {
            self.end_session(node, Cause::Farewell(why));
        }
    }

    fn next_end(&self, now: Instant) -> Option<(NodeId, Farewell)> {
        let waits = |it| self.reload_requests.is_applying(it);
        self.reload.next_end(now, waits)
    }

    /// Whether a part of the work can be done now.
    pub(super) fn is_policy_due(&self, now: Instant) -> bool {
        let waits = |it| self.reload_requests.is_applying(it);
        self.reload.is_due(now, waits)
    }

    //= SM2-ACC-013
    fn deny(&mut self, at: EntityId, budget: &mut Budget) -> Pass {
        let Some(entity) = self.registry.sessions().member_from(at) else {
            return Pass::Allow(EntityId::FIRST, None);
        };
        let next = Pass::Deny(following(entity));
        budget.spend(PAIR + self.registry.access().cost());
        if entity == EntityId::node(entity.node) {
            let access = self.registry.access();
            if access.refuse_welcomed(entity.node).is_err() {
                self.reload.denied.insert(entity.node);
            }
            return next;
        }
        if self.is_granted(entity)
            && let Some(contract) = self.registry.sessions().contract(entity)
            && let Err(reason) = self.judge(entity, contract)
        {
            budget.spend(MARK);
            self.suspend_answered(entity, reason);
        }
        if self.is_granted(entity) || self.end_suspended(entity, budget) {
            next
        } else {
            Pass::Deny(entity)
        }
    }

    /// Judges an interface. Of the publishers of an exclusive topic, the first one stays.
    //= SM2-ACC-009, SM2-ACC-013
    fn judge(&self, entity: EntityId, contract: &Contract) -> Result<(), Refusal> {
        let channel = self.registry.channel(contract);
        let others = channel.map_or(0, |channel| match self.is_granted(entity) {
            true => usize::from(channel.has_offering_before(entity)),
            false => channel.counterpart_count(Kind::Subscriber),
        });
        let access = self.registry.access();
        access.refuse_interface(entity.node, contract, others)?;
        match channel {
            Some(channel) if !self.is_granted(entity) => channel.refuse_types(contract),
            _ => Ok(()),
        }
    }

    /// Suspends an interface that was granted or suspended in this session: its node answers.
    //= SM2-ACC-014
    fn suspend_answered(&mut self, entity: EntityId, reason: Refusal) {
        self.reload.ask(entity, None);
        self.registry.suspend(entity, reason.clone());
        self.send_refusal(entity, reason);
    }

    /// Ends the links of a suspended interface. Returns whether none is left.
    //= SM2-ACC-014
    fn end_suspended(&mut self, entity: EntityId, budget: &mut Budget) -> bool {
        // Each part ends one at least, even if the judgement has spent the budget.
        loop {
            let record = self.registry.sessions().record(entity.node);
            if let Some((link, pair)) = record.and_then(|it| it.first_live(entity.interface)) {
                budget.spend(2 * UNLINK);
                self.deny_link(entity, link, pair);
            } else if !self.forget_pair(entity, budget) {
                return true;
            }
            if budget.is_spent() {
                return false;
            }
        }
    }

    /// Ends a live link of a suspended interface at both ends.
    //= SM2-ACC-014, SM2-LNK-006
    fn deny_link(&mut self, entity: EntityId, link: LinkId, pair: Option<Pair>) {
        let code = Farewell::Denied.code();
        let unheard_of = pair.is_some_and(|it| self.registry.pending_links.remove(it, link));
        match pair {
            None => self.registry.give_up_claim(entity, link),
            Some(pair) => drop(self.registry.remove_link(link, pair)),
        }
        for end in pair.map_or([Some(entity), None], |it| it.entities().map(Some)) {
            match end {
                Some(end) if unheard_of => self.registry.remove_end(end, link),
                Some(end) => self.begin_unlink(end, link, code),
                None => {}
            }
        }
    }

    //= SM2-ACC-013
    fn allow(
        &mut self,
        at: EntityId,
        after: Option<EntityId>,
        budget: &mut Budget,
    ) -> Option<Pass> {
        let entity = self.registry.sessions().member_from(at)?;
        let next = Pass::Allow(following(entity), None);
        budget.spend(PAIR);
        let mut after = after.filter(|_| entity == at);
        if let Some(contract) = self.registry.sessions().contract(entity).cloned()
            && !self.is_granted(entity)
        {
            budget.spend(self.registry.access().cost());
            match self.judge(entity, &contract) {
                Ok(()) => {
                    self.grant_again(entity, &contract);
                    after = Some(EntityId::FIRST);
                }
                Err(reason) if self.registry.sessions().suspension(entity) != Some(&reason) => {
                    budget.spend(MARK);
                    self.suspend_answered(entity, reason);
                }
                Err(_) => {}
            }
        }
        // The interfaces of a session that resumes are linked after CLAIMED.
        let Some(after) = after.filter(|_| self.registry.sessions().may_link(entity.node)) else {
            return Some(next);
        };
        let (links, more) = self.link_missing(entity, after, budget);
        self.outbox.extend(links);
        Some(more.map_or(next, |after| Pass::Allow(entity, Some(after))))
    }

    /// Ends the suspension of an interface. LINKs follow later, so `matches` is 0.
    fn grant_again(&mut self, entity: EntityId, contract: &Arc<Contract>) {
        let EntityId { node, interface } = entity;
        self.registry.resume(entity, contract);
        let matches = 0;
        self.outbox
            .send(node, &ToNode::Declared { interface, matches });
    }

    fn is_granted(&self, entity: EntityId) -> bool {
        self.registry.sessions().is_granted(entity)
    }
}

/// The smallest id above one.
const fn following(EntityId { node, interface }: EntityId) -> EntityId {
    match interface.0.checked_add(1) {
        Some(next) => EntityId {
            node,
            interface: InterfaceId(next),
        },
        None => EntityId::node(NodeId(node.0.saturating_add(1))),
    }
}
