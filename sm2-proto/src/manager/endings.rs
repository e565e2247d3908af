//! How interfaces and links end, and which matching pairs are without a link (SPEC sections 4.3,
//! 4.4 and 5).

use super::{
    Manager,
    budget::Budget,
    links::Pair,
    node_record::{Farewells, Remains},
    session::Session,
};
use crate::{
    Code, EntityId, Farewell, Instant, LinkId, Violation,
    control::{Key, Limit, ToNode, UnlinkedReason},
};

impl Manager {
    /// The driver could not make a link, so neither end hears of it. The pair is linked again later.
    //= SM2-IFC-002, SM2-LNK-008
    pub(super) fn link_failed(&mut self, now: Instant, link: LinkId) {
        let Some(pair) = self.links.made(link) else {
            return;
        };
        if self.pending_links.contains(pair.offering.node, link) {
            // The link is pending: the driver was not asked to make it yet.
            return;
        }
        self.forget_link(link, pair);
        for entity in pair.entities() {
            self.remove_link(entity, link);
        }
        self.not_sent(pair);
        self.mark_unlinked(pair, UnlinkedReason::Descriptors);
        if self.is_there(pair) {
            self.shortage.failed(pair, now);
        }
    }

    /// Removes an end of a link that its session was never told of. Its interface may be gone, and
    /// its links are then being ended.
    pub(super) fn remove_link(&mut self, entity: EntityId, link: LinkId) {
        let record = self.sessions.get_mut(&entity.node);
        if let Some(record) = record.and_then(Session::node_mut) {
            record.remove_link(entity.interface, link);
        }
        self.ending_links.forget(entity, link);
    }

    //= SM2-IFC-003
    pub(super) fn withdraw(&mut self, entity: EntityId) -> Result<(), Violation> {
        let was_short = self.is_short_of_ends(entity.node);
        let record = self.sessions.get_mut(&entity.node);
        let (who, remains) = record
            .and_then(Session::node_mut)
            .and_then(|it| Some((it.credentials(), it.withdraw(entity.interface)?)))
            .ok_or(violation!(UnknownInterface, "SM2-IFC-003"))?;
        self.users.withdraw(who, 1);
        //= SM2-LNK-007
        if was_short {
            self.pending_links.has_room(entity.node);
        }
        self.reload.forget_interface(entity);
        self.end_interface(entity, remains, Farewell::Done);
        self.work(entity.node, &mut Budget::new(&self.limits));
        let interface = entity.interface;
        self.send(entity.node, &ToNode::Withdrawn { interface });
        Ok(())
    }

    /// Removes an interface that its session has given up from the channels. Its links end with
    /// [`work`](Self::work).
    //= SM2-IFC-003, SM2-SES-006, SM2-SES-009
    pub(super) fn end_interface(
        &mut self,
        entity: EntityId,
        (contract, links): Remains,
        cause: Farewell,
    ) {
        self.channels.remove(entity, &contract);
        self.access.begin_end(entity, &contract);
        self.member_changed(entity);
        self.ending_links.insert(entity, cause, links);
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
        let EntityId { node, interface } = entity;
        let was_short = self.is_short_of_ends(node);
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        let record = record.ok_or(violation!(UnknownInterface, "SM2-LNK-003"))?;
        if self.pending_links.contains(node, link) && record.has_link(interface, link) == Some(true)
        {
            // The node was not told of this link, so it can only have guessed the number.
            return Err(violation!(UnknownLink, "SM2-LNK-003"));
        }
        let farewells = record.farewell(interface, link)?;
        self.reload.confirm(entity, Some(link));
        //= SM2-LNK-007
        if was_short {
            self.pending_links.has_room(node);
        }
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
        if !self.is_there(pair) || self.links.joins(pair) {
            return;
        }
        let again = is_shortage(code);
        for node in pair.nodes() {
            if let Some(session) = self.sessions.get_mut(&node) {
                session.ended(pair, again);
            }
        }
        // The interfaces of a session that resumes are linked with all their matches after CLAIMED.
        if again && pair.nodes().all(|node| self.may_link(node)) {
            self.shortage.failed(pair, now);
        }
        self.mark_unlinked(pair, UnlinkedReason::Ended { code });
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
        match pair {
            None => self.give_up_claim(gone, link),
            Some(pair) => {
                let unheard_of = self.pending_links.remove(pair, link);
                let other = pair.other(gone);
                if self.forget_link(link, pair) {
                    if unheard_of {
                        self.remove_link(other, link);
                    } else {
                        self.begin_unlink(other, link, code);
                    }
                }
            }
        }
    }

    /// Remembers why a matching pair is not linked, as far as the quota allows. An interface that
    /// is gone has no match.
    //= SM2-WCH-004
    pub(super) fn mark_unlinked(&mut self, pair: Pair, reason: UnlinkedReason) {
        if self.is_there(pair)
            && self.unlinked_pairs.insert(
                pair,
                reason,
                self.limits.count(Limit::UnlinkedPerSession),
            )
        {
            self.changed(key(pair));
        }
    }

    /// Forgets why a pair was not linked.
    pub(super) fn mark_linked(&mut self, pair: Pair) {
        if self.unlinked_pairs.remove(pair) {
            self.changed(key(pair));
        }
    }
}

/// Whether a node ended a link for lack of descriptors or memory.
pub(super) fn is_shortage(code: Code) -> bool {
    code == Farewell::Resources.code()
}

const fn key(pair: Pair) -> Key {
    Key::Unlinked {
        offering: pair.offering,
        demanding: pair.demanding,
    }
}
