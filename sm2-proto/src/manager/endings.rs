//! How interfaces and links end (SPEC sections 4.3, 4.4 and 5).

use super::{Manager, budget::Budget, links::Pair, node_record::Farewells};
use crate::{
    Code, EntityId, Farewell, Instant, LinkId, Violation,
    control::{ToNode, UnlinkedReason},
};

impl Manager {
    /// The driver could not make a link, so neither end hears of it. The pair is linked again later.
    //= SM2-IFC-002, SM2-LNK-008
    pub(super) fn link_failed(&mut self, now: Instant, link: LinkId) {
        let Some(pair) = self.registry.take_back(link) else {
            return;
        };
        self.registry
            .mark_unlinked(pair, UnlinkedReason::Descriptors);
        if self.registry.sessions().are_there(pair) {
            self.shortage.failed(pair, now);
        }
    }

    //= SM2-IFC-003
    pub(super) fn withdraw(&mut self, entity: EntityId) -> Result<(), Violation> {
        self.registry.withdraw(entity)?;
        self.reload.forget_interface(entity);
        self.work(entity.node, &mut Budget::new(&self.limits));
        let interface = entity.interface;
        self.outbox
            .send(entity.node, &ToNode::Withdrawn { interface });
        Ok(())
    }

    /// UNLINKED: a node says farewell to its end of a link.
    //= SM2-LNK-003, SM2-LNK-009, SM2-RES-006
    pub(super) fn unlinked(
        &mut self,
        now: Instant,
        entity: EntityId,
        link: LinkId,
        code: Code,
    ) -> Result<(), Violation> {
        let farewells = self.registry.farewell(entity, link)?;
        self.reload.confirm(entity, Some(link));
        match farewells {
            Farewells::Second(pair) => {
                if let Some(pair) = pair.filter(|_| is_shortage(code)) {
                    self.ended(now, pair, code);
                }
            }
            Farewells::First(pair) => {
                self.send_unlink(entity, link, code);
                self.end_link(link, pair, entity, code);
                if let Some(pair) = pair {
                    self.ended(now, pair, code);
                }
            }
        }
        Ok(())
    }

    /// A side of a pair ended their link. Only a lack of descriptors or memory is a reason to link
    /// the pair again.
    //= SM2-LNK-009, SM2-WCH-004
    fn ended(&mut self, now: Instant, pair: Pair, code: Code) {
        let sessions = self.registry.sessions();
        if !sessions.are_there(pair) || self.registry.links().joins(pair) {
            return;
        }
        let again = is_shortage(code);
        // The interfaces of a session that resumes are linked with all their matches after CLAIMED.
        if again && pair.nodes().all(|node| sessions.may_link(node)) {
            self.shortage.failed(pair, now);
        }
        for node in pair.nodes() {
            if let Some(session) = self.registry.session_mut(node) {
                session.ended(pair, again);
            }
        }
        self.registry
            .mark_unlinked(pair, UnlinkedReason::Ended { code });
    }

    /// One end of a link is gone. The other end gets UNLINK if the link was live at both ends and
    /// its LINKs were sent.
    //= SM2-LNK-006
    pub(super) fn end_link(
        &mut self,
        link: LinkId,
        pair: Option<Pair>,
        gone: EntityId,
        code: Code,
    ) {
        let Some(pair) = pair else {
            return self.registry.give_up_claim(gone, link);
        };
        let unheard_of = self.registry.pending_links.remove(pair, link);
        let other = pair.other(gone);
        if self.registry.remove_link(link, pair) {
            if unheard_of {
                self.registry.remove_end(other, link);
            } else {
                self.begin_unlink(other, link, code);
            }
        }
    }
}

/// Whether a node ended a link for lack of descriptors or memory.
pub(super) fn is_shortage(code: Code) -> bool {
    code == Farewell::Resources.code()
}
