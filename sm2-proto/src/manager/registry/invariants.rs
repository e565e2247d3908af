//! The invariants between the tables of a domain. Debug builds check them after each input.

use super::Registry;
use crate::{
    EntityId, LinkId,
    control::Limit,
    manager::{links::Pair, node_record::NodeRecord, session::Session, sessions::broken},
    match_contracts,
};

/// A larger domain is checked only once in [`SPACING`] revisions, because the cost of a check grows
/// with the domain.
const SMALL: usize = 64;
const SPACING: u64 = 64;

impl Registry {
    /// Whether the invariants are to be checked at this revision.
    pub(in crate::manager) fn is_to_be_checked(&self) -> bool {
        let size = self.sessions.iter().len() + self.channels.len() + self.links.len();
        size <= SMALL || self.log.revision().is_multiple_of(SPACING)
    }

    /// The first rule that does not hold.
    pub(in crate::manager) fn broken_rule(&self) -> Option<&'static str> {
        let sessions = self.sessions.broken_rule(&self.limits);
        let sessions = sessions.or_else(|| self.broken_rule_of_sessions());
        sessions.or_else(|| self.broken_rule_of_links())
    }

    fn broken_rule_of_sessions(&self) -> Option<&'static str> {
        let records = || self.sessions.records();
        let welcomed = self.sessions.iter().filter(|(_, it)| it.node().is_some());
        let until = Session::claims_until;
        let expiring = self.sessions.iter().filter_map(|(_, it)| until(it));
        let mut expired = self.claims.expiring();
        broken([
            (
                self.access.is_about(welcomed.map(|(node, _)| node)),
                "exactly the welcomed sessions are subjects of the access policy",
            ),
            (
                records().map(NodeRecord::granted).sum::<usize>() == self.channels.ends(),
                "each interface that is not suspended stands in one channel",
            ),
            (
                self.channels.are_tight(),
                "each channel has interfaces, and a type as long as one states it",
            ),
            (
                expiring.count() == self.claims.expiring().count()
                    && expired
                        .all(|(at, node)| self.sessions.get(node).and_then(until) == Some(at)),
                "the sessions whose claims expire are those that know it",
            ),
            (
                self.watchers
                    .iter()
                    .all(|&it| self.sessions.get(it).is_some()),
                "each session that waits for changes is there",
            ),
        ])
    }

    fn broken_rule_of_links(&self) -> Option<&'static str> {
        let ends = || self.sessions.records().flat_map(NodeRecord::live_ends);
        let ending = || self.ending_links.pairs();
        let claims = ends().filter(|(_, _, pair)| pair.is_none()).count()
            + ending().filter(Option::is_none).count();
        let count = ends().count() + ending().count();
        let made = self.links.iter().all(|(link, pair)| {
            let has = |it: EntityId| self.end_of(it, link) == Some(Some(pair));
            pair.entities().into_iter().all(has) && self.is_sound(pair)
        });
        let claimed = |(link, it)| self.end_of(it, link) == Some(None);
        let claimed = self.claims.iter().all(claimed);
        let unlinked = self.limits.count(Limit::UnlinkedPerSession);
        broken([
            (
                self.sessions.iter().all(|(node, session)| {
                    let is_pending = |link| self.pending_links.contains(node, link);
                    session
                        .node()
                        .is_none_or(|it| it.counts_known_ends(is_pending))
                }),
                "each session knows how many ends of links its node knows",
            ),
            (
                self.links.agree() && made && count == 2 * self.links.len() + claims,
                "links join matching pairs, each once, and both ends know",
            ),
            (
                self.claims.agree() && claimed && self.claims.iter().count() == claims,
                "each claim without a counterpart is a live end of its session",
            ),
            (
                self.unlinked_pairs.agree(unlinked)
                    && self.unlinked_pairs.iter().all(|it| self.may_be_linked(it)),
                "unlinked pairs match, are not linked, and are within their quota",
            ),
            (
                self.flow_control_agrees(),
                "links wait for their LINKs only as long as they have to",
            ),
        ])
    }

    /// The pair of a live end, or of one whose interface is gone.
    fn end_of(&self, entity: EntityId, link: LinkId) -> Option<Option<Pair>> {
        let record = self.sessions.record(entity.node);
        let live = record.and_then(|it| it.live_link(entity.interface, link));
        live.or_else(|| self.ending_links.link(entity, link))
    }

    /// Whether a pair is sound, and has no link.
    pub(in crate::manager) fn may_be_linked(&self, pair: Pair) -> bool {
        self.is_sound(pair) && !self.links.joins(pair)
    }

    /// Whether a pair matches, or one of its interfaces is gone and will be forgotten.
    fn is_sound(&self, pair: Pair) -> bool {
        let [one, other] = pair.entities().map(|it| self.sessions.contract(it));
        let gone = |it: EntityId| self.ending_links.has_interface(it);
        matches!((one, other), (Some(one), Some(other)) if match_contracts(one, other).is_ok())
            || pair.entities().into_iter().any(gone)
    }
}
