//! What another set of rules would change: decided by the rules alone, of what is there.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::gateway::{Action, Direction, GatewayId, Rules};

use crate::tally::Key;

/// Rules, and the peers that they are for: others are not trusted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RuleSet {
    /// The rules.
    pub rules: Rules,
    /// Who is trusted.
    pub peers: BTreeSet<GatewayId>,
}

/// The topics and services that are there, by kind and name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    /// In the domain.
    pub local: BTreeSet<Key>,
    /// Offered by peers.
    pub offers: BTreeMap<GatewayId, BTreeSet<Key>>,
}

/// What would not be as it is.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Change {
    /// To whom, or from whom.
    pub peer: GatewayId,
    /// Which of both.
    pub direction: Direction,
    /// What.
    pub of: Key,
    /// Whether it would go; otherwise it goes now.
    pub would_go: bool,
    /// What says so in the other rules.
    pub because: Because,
}

/// What decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Because {
    /// The rule of this index.
    Rule(usize),
    /// No rule fits: the answer is no.
    NoRule,
    /// The peer is not trusted.
    NoPeer,
}

/// All that would change if `then` were in the place of `now`, in a fixed order.
///
/// What the domain has goes out if the rules let it; what one peer offers comes in from it, and goes out
/// to each other one that may have it.
#[must_use]
pub fn changes(now: &RuleSet, then: &RuleSet, seen: &Seen) -> Vec<Change> {
    let mut changes = Vec::new();
    let offered: BTreeSet<&Key> = seen.offers.values().flatten().collect();
    let known: BTreeSet<&Key> = offered.into_iter().chain(&seen.local).collect();
    for &peer in now.peers.union(&then.peers) {
        let offers = seen.offers.get(&peer).into_iter().flatten();
        let into = offers.map(|of| (Direction::In, of));
        let out = known.iter().map(|of| (Direction::Out, *of));
        for (direction, of) in into.chain(out) {
            let decide = |by: &RuleSet| match direction {
                Direction::In => by.decide(of, Direction::In, peer),
                Direction::Out => by.goes_out(of, peer, seen),
            };
            let (goes, (would_go, because)) = (decide(now).0, decide(then));
            if goes != would_go {
                changes.push(Change {
                    peer,
                    direction,
                    of: of.clone(),
                    would_go,
                    because,
                });
            }
        }
    }
    changes
}

impl RuleSet {
    fn decide(&self, (kind, name): &Key, direction: Direction, peer: GatewayId) -> (bool, Because) {
        if !self.peers.contains(&peer) {
            return (false, Because::NoPeer);
        }
        let decision = self.rules.decide(*kind, name, direction, &peer);
        let because = decision.rule.map_or(Because::NoRule, Because::Rule);
        (decision.action == Action::Allow, because)
    }

    /// It has to be there: from the domain, or from another peer that it may come in from.
    fn goes_out(&self, of: &Key, peer: GatewayId, seen: &Seen) -> (bool, Because) {
        let out = self.decide(of, Direction::Out, peer);
        if !out.0 || seen.local.contains(of) {
            return out;
        }
        let others = seen.offers.iter().filter(|(it, _)| **it != peer);
        let has = others.filter(|(_, offers)| offers.contains(of));
        let mut comes = has.map(|(it, _)| self.decide(of, Direction::In, *it));
        // Without one that may come in, the first one that may not says why.
        let Some(first) = comes.next() else {
            return (false, Because::NoRule);
        };
        match first.0 || comes.any(|it| it.0) {
            true => out,
            false => first,
        }
    }
}
