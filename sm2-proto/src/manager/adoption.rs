//! Adopts links of earlier Managers. Nodes that come back claim their links, and this Manager
//! adopts a link once both ends have claimed it (SPEC section 11).

use super::{
    Cause, Manager,
    budget::Budget,
    claims::Claim,
    endings::is_shortage,
    links::{Agreed, Pair},
};
use crate::{
    Code, EntityId, Farewell, Instant, LinkId, NodeId, VERSION, Violation,
    control::{Limit, ToNode},
    match_contracts,
};

impl Manager {
    //= SM2-RES-003, SM2-RES-004, SM2-RES-008
    pub(super) fn claim(
        &mut self,
        entity: EntityId,
        link: LinkId,
        claim: Claim,
    ) -> Result<(), Violation> {
        let EntityId { node, interface } = entity;
        let ours = self.registry.links().epoch();
        let Some(session) = self.registry.session_mut(node) else {
            return Ok(());
        };
        let record = session.node();
        let known = record.and_then(|it| it.has_link(interface, link));
        let known = known.ok_or(violation!(UnknownInterface, "SM2-RES-003"))?;
        if known || link.epoch == ours || claim.agreed.version != VERSION {
            return Err(violation!(BadClaim, "SM2-RES-003"));
        }
        if !session.may_claim() {
            self.end_session(node, Cause::Farewell(Farewell::Resources));
            return Ok(());
        }
        let record = session.node_mut();
        let record = record.ok_or(violation!(UnknownInterface, "SM2-RES-003"))?;
        record.claim(interface, link);
        //= SM2-ACC-014
        if record.suspended(interface).is_some() {
            self.begin_unlink(entity, link, Farewell::Denied.code());
        } else if record.link_ends() > self.limits.links_per_session() {
            self.begin_unlink(entity, link, Farewell::Resources.code());
        } else if let Some(other) = self.registry.claim(entity, link, claim) {
            self.adopt(link, [entity, other], claim.agreed);
        }
        Ok(())
    }

    /// Handles the second of two claims that agree.
    //= SM2-RES-004, SM2-RES-005
    fn adopt(&mut self, link: LinkId, ends: [EntityId; 2], agreed: Agreed) {
        match self.adoptable(ends, agreed) {
            Some(pair) => self.insert_link(link, pair, agreed, false),
            None => {
                for end in ends {
                    self.begin_unlink(end, link, Farewell::NotAdopted.code());
                }
            }
        }
    }

    /// The pair that a claimed link joins, if this Manager would make such a link now.
    //= SM2-RES-005, SM2-MAT-003
    fn adoptable(&self, [one, other]: [EntityId; 2], agreed: Agreed) -> Option<Pair> {
        let sessions = self.registry.sessions();
        let (uid, ours) = sessions.user_and_contract(one)?;
        let (their_uid, theirs) = sessions.user_and_contract(other)?;
        let qos = match_contracts(ours, theirs).ok()?;
        let pair = Pair::new(one, ours, other);
        let sealed = qos.sealed || self.limits.seals(uid == their_uid);
        let fits = agreed.qos.reliable == qos.reliable && (agreed.qos.sealed || !sealed);
        (fits && !self.registry.links().joins(pair)).then_some(pair)
    }

    /// CLAIMED: the session has claimed all its links. From now on it is linked like any other one.
    //= SM2-RES-006, SM2-RES-007
    pub(super) fn claimed(&mut self, now: Instant, node: NodeId) {
        let record = self.registry.sessions().record(node);
        let has_half = record.is_some_and(|it| it.half_claims().next().is_some());
        let until = has_half.then(|| now.after(self.limits.time(Limit::Recovery)));
        self.registry.claimed(node, until);
        self.work(node, &mut Budget::new(&self.limits));
    }

    /// Marks the sessions whose claims have waited long enough. Their next parts of
    /// [`work`](Self::work) give the claims up.
    //= SM2-RES-006
    pub(super) fn expire_claims(&mut self, now: Instant) {
        while let Some(node) = self.registry.pop_expired(now) {
            self.expired.insert(node);
            self.jobs.insert(node);
        }
    }

    /// Sends the Manager's UNLINK for a live end of a link.
    pub(super) fn begin_unlink(&mut self, entity: EntityId, link: LinkId, code: Code) {
        // UNLINKED repeats the code of UNLINK, so only after another code it tells of a shortage.
        if !self.registry.begin_unlink(entity, link, !is_shortage(code)) {
            return;
        }
        //= SM2-ACC-014
        if code == Farewell::Denied.code() {
            self.reload.ask(entity, Some(link));
        }
        self.send_unlink(entity, link, code);
    }

    /// Sends UNLINK.
    pub(super) fn send_unlink(&mut self, entity: EntityId, link: LinkId, code: Code) {
        let EntityId { node, interface } = entity;
        self.outbox.send(
            node,
            &ToNode::Unlink {
                interface,
                link,
                code,
            },
        );
    }
}
