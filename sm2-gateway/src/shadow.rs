//! The differences between two sets of rules, for given topics and services.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::gateway::{Action, Direction, GatewayId, Rules};

use crate::tally::Key;

/// Rules, and the peers that they apply to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RuleSet {
    /// The rules.
    pub rules: Rules,
    /// The trusted peers.
    pub peers: BTreeSet<GatewayId>,
}

/// The known topics and services, by kind and name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    /// In the domain.
    pub local: BTreeSet<Key>,
    /// Offered by peers.
    pub offers: BTreeMap<GatewayId, BTreeSet<Key>>,
}

/// A topic or service that would start or stop being carried.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Change {
    /// The peer.
    pub peer: GatewayId,
    /// From or to the peer.
    pub direction: Direction,
    /// The topic or service.
    pub of: Key,
    /// Whether it would start or stop being carried.
    pub effect: Effect,
    /// The reason in the other rules.
    pub because: Because,
}

/// The effect of a change of rules on a topic or service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Effect {
    /// The gateway would stop carrying it.
    Stops,
    /// The gateway would start carrying it.
    Starts,
}

/// The reason of a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Because {
    /// The rule with this index.
    Rule(usize),
    /// No rule matches, so the name is denied.
    NoRule,
    /// The peer is not trusted.
    NoPeer,
}

/// Returns the differences if `then` replaced `now`, in a fixed order.
///
/// A subject of the domain goes out to each peer that the rules allow. A subject of a peer comes in from
/// that peer, and goes out to each other peer that the rules allow.
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
            let ((is_carried, _), (would_be_carried, because)) = (decide(now), decide(then));
            let effect = match (is_carried, would_be_carried) {
                (false, true) => Effect::Starts,
                (true, false) => Effect::Stops,
                (false, false) | (true, true) => continue,
            };
            changes.push(Change {
                peer,
                direction,
                of: of.clone(),
                effect,
                because,
            });
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

    /// A subject goes out only if the domain has it, or if it may come in from another peer.
    fn goes_out(&self, of: &Key, peer: GatewayId, seen: &Seen) -> (bool, Because) {
        let out = self.decide(of, Direction::Out, peer);
        if !out.0 || seen.local.contains(of) {
            return out;
        }
        let others = seen.offers.iter().filter(|(it, _)| **it != peer);
        let has = others.filter(|(_, offers)| offers.contains(of));
        let mut comes = has.map(|(it, _)| self.decide(of, Direction::In, *it));
        // If it may come in from none of them, the decision about the first one is the reason.
        let Some(first) = comes.next() else {
            return (false, Because::NoRule);
        };
        match first.0 || comes.any(|it| it.0) {
            true => out,
            false => first,
        }
    }
}
