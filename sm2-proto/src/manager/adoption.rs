//! Adopts links of earlier Managers. Nodes that come back claim their links, and this Manager
//! adopts a link once both ends have claimed it (SPEC section 11).

use super::{
    Cause, Manager,
    budget::Budget,
    claims::Claim,
    endings::is_shortage,
    links::{Agreed, Pair},
    session::Session,
};
use crate::{
    Code, EntityId, Farewell, Instant, LinkId, NodeId, VERSION, Violation,
    control::{Key, Limit, ToNode},
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
        let limit = self.limits.links_per_session();
        let Some(session) = self.sessions.get_mut(&node) else {
            return Ok(());
        };
        let record = session.node();
        let known = record.and_then(|it| it.has_link(interface, link));
        let known = known.ok_or(violation!(UnknownInterface, "SM2-RES-003"))?;
        if known || link.epoch == self.links.epoch() || claim.agreed.version != VERSION {
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
            return Ok(());
        }
        if record.link_ends() > limit {
            self.begin_unlink(entity, link, Farewell::Resources.code());
            return Ok(());
        }
        match self.claims.meet(link, entity, claim) {
            None => self.changed(Key::Claim { link, entity }),
            Some(other) => {
                self.changed(Key::Claim {
                    link,
                    entity: other,
                });
                self.adopt(link, [entity, other], claim.agreed);
            }
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
        let (uid, ours) = self.user_and_contract(one)?;
        let (their_uid, theirs) = self.user_and_contract(other)?;
        let qos = match_contracts(ours, theirs).ok()?;
        let pair = Pair::new(one, ours, other);
        let sealed = qos.sealed || self.limits.seals(uid == their_uid);
        let fits = agreed.qos.reliable == qos.reliable && (agreed.qos.sealed || !sealed);
        (fits && !self.links.joins(pair)).then_some(pair)
    }

    /// CLAIMED: the session has claimed all its links. From now on it is linked like any other one.
    //= SM2-RES-006, SM2-RES-007, SM2-SES-004
    pub(super) fn claimed(&mut self, now: Instant, node: NodeId) {
        let Some(session) = self.sessions.remove(&node) else {
            return;
        };
        let record = session.node();
        let has_half = record.is_some_and(|it| it.half_claims().next().is_some());
        let until = has_half.then(|| now.after(self.limits.time(Limit::Recovery)));
        self.sessions.insert(node, session.claimed(until));
        if let Some(until) = until {
            self.claims.expire_at(until, node);
        }
        self.greeting.remove(&node);
        self.node_changed(node);
        self.work(node, &mut Budget::new(&self.limits));
    }

    /// Marks the sessions whose claims have waited long enough. Their next parts of
    /// [`work`](Self::work) give the claims up.
    //= SM2-RES-006
    pub(super) fn expire_claims(&mut self, now: Instant) {
        while let Some(node) = self.claims.pop_expired(now) {
            if let Some(session) = self.sessions.get_mut(&node) {
                session.claims_expired();
                self.expired.insert(node);
                self.jobs.insert(node);
            }
        }
    }

    /// Removes a claim without telling any node.
    pub(super) fn give_up_claim(&mut self, entity: EntityId, link: LinkId) {
        if self.claims.remove(link, entity) {
            self.changed(Key::Claim { link, entity });
        }
    }

    /// Sends the Manager's UNLINK for a live end of a link.
    pub(super) fn begin_unlink(&mut self, entity: EntityId, link: LinkId, code: Code) {
        let EntityId { node, interface } = entity;
        // UNLINKED repeats the code of UNLINK, so only after another code it tells of a shortage.
        let record = self.sessions.get(&node).and_then(Session::node);
        let pair = record
            .and_then(|it| it.live_link(interface, link))
            .flatten();
        let pair = pair.filter(|&it| !is_shortage(code) && self.is_there(it));
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        let is_live = record.is_some_and(|it| it.begin_unlink(interface, link, pair));
        if !is_live {
            // The interface is gone, and its links are being ended.
            return self.ending_links.forget(entity, link);
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
        self.send(
            node,
            &ToNode::Unlink {
                interface,
                link,
                code,
            },
        );
    }
}
