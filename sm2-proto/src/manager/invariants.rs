//! The invariants between the tables of a Manager. Debug builds check them after each input.

use super::{Manager, links::Pair, node_record::NodeRecord, phase::Phase, session::Session};
use crate::control::Limit;
use crate::{EntityId, LinkId, NodeId, match_contracts};

/// A larger domain is checked only once in [`SPACING`] revisions, because the cost of a check grows
/// with the domain.
const SMALL: usize = 64;
const SPACING: u64 = 64;

impl Manager {
    /// The first rule that does not hold.
    pub(super) fn invariants(&self) -> Result<(), &'static str> {
        let size = self.sessions.len() + self.channels.len() + self.links.len();
        if size > SMALL && !self.log.revision().is_multiple_of(SPACING) {
            return Ok(());
        }
        self.sessions_agree()?;
        self.links_agree()?;
        rules(&[
            (
                self.channels.are_tight(),
                "each channel has interfaces, and a type as long as one states it",
            ),
            (
                self.unlinked_pairs
                    .agree(self.limits.count(Limit::UnlinkedPerSession))
                    && self
                        .unlinked_pairs
                        .iter()
                        .all(|it| self.is_sound(it) && !self.links.joins(it)),
                "unlinked pairs match, are not linked, and are within their quota",
            ),
            (
                self.schemas
                    .are(self.each_node().flat_map(NodeRecord::schemas)),
                "each schema is there as often as sessions registered it",
            ),
            (
                self.flow_control_agrees(),
                "links wait for their LINKs only as long as they have to",
            ),
            (
                self.shortage
                    .pairs()
                    .all(|it| self.is_sound(it) && !self.links.joins(it)),
                "pairs that are to be linked again match, and have no link",
            ),
            (
                self.jobs_agree(),
                "busy sessions wait for their turn, and no others",
            ),
            (
                self.watchers
                    .iter()
                    .all(|it| self.sessions.contains_key(it)),
                "whoever waits for changes is there",
            ),
            (
                self.reload_requests_agree(),
                "whoever waits for a policy is welcomed",
            ),
        ])
    }

    fn each(&self) -> impl Iterator<Item = &Session> {
        self.sessions.values()
    }

    fn each_node(&self) -> impl Iterator<Item = &NodeRecord> {
        self.each().filter_map(Session::node)
    }

    fn welcomed(&self) -> impl Iterator<Item = NodeId> {
        let sessions = self.sessions.iter();
        let welcomed = sessions.filter(|(_, it)| it.node().is_some());
        welcomed.map(|(&node, _)| node)
    }

    fn sessions_agree(&self) -> Result<(), &'static str> {
        let not_ready = self.sessions.iter();
        let not_ready = not_ready.filter(|(_, it)| it.phase() != Phase::Ready);
        let until = Session::claims_until;
        rules(&[
            (
                self.each_node().count() == self.names.len(),
                "each welcomed session has one name, and each name one",
            ),
            (
                self.access.is_about(self.welcomed()),
                "exactly the welcomed sessions are subjects of the access policy",
            ),
            (
                not_ready.map(|(node, _)| node).eq(self.greeting.keys()),
                "each session that is not ready has a deadline, and no other one",
            ),
            (
                self.each_node().map(NodeRecord::granted).sum::<usize>() == self.channels.ends(),
                "each interface that is not suspended stands in one channel",
            ),
            (
                self.each_node()
                    .all(|it| it.refused().len() <= self.limits.count(Limit::RefusalsPerSession)),
                "refusals are remembered within their quota",
            ),
            (
                self.users.are(self.each()),
                "charges per user equal a recount",
            ),
            (
                self.each().filter_map(until).count() == self.claims.expiring().count()
                    && self
                        .claims
                        .expiring()
                        .all(|(at, node)| self.sessions.get(&node).and_then(until) == Some(at)),
                "the sessions whose claims expire are those that know it",
            ),
        ])
    }

    fn links_agree(&self) -> Result<(), &'static str> {
        let ends = || self.each_node().flat_map(NodeRecord::live_ends);
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
        rules(&[
            (
                self.each_node().all(NodeRecord::counts_its_ends),
                "each session knows how many ends of links it has",
            ),
            (
                self.sessions.iter().all(|(&node, session)| {
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
        ])
    }

    /// The pair of a live end, or of one whose interface is gone.
    fn end_of(&self, entity: EntityId, link: LinkId) -> Option<Option<Pair>> {
        let record = self.sessions.get(&entity.node).and_then(Session::node);
        let live = record.and_then(|it| it.live_link(entity.interface, link));
        live.or_else(|| self.ending_links.link(entity, link))
    }

    /// Whether a pair matches, or one of its interfaces is gone and will be forgotten.
    fn is_sound(&self, pair: Pair) -> bool {
        let gone = |it: EntityId| self.ending_links.has_interface(it);
        self.is_match(pair) || pair.entities().into_iter().any(gone)
    }

    fn is_match(&self, pair: Pair) -> bool {
        let [one, other] = pair.entities().map(|it| self.user_and_contract(it));
        matches!((one, other), (Some((_, one)), Some((_, other)))
            if match_contracts(one, other).is_ok())
    }
}

fn rules(rules: &[(bool, &'static str)]) -> Result<(), &'static str> {
    let broken = rules.iter().find(|(holds, _)| !holds);
    broken.map_or(Ok(()), |&(_, rule)| Err(rule))
}
