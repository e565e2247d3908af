//! The differences that the rules of another configuration would make, without effect.

use std::collections::{BTreeMap, BTreeSet};
use std::mem;

use sm2_gateway::report::ShadowReport;
use sm2_gateway::shadow::{Change, RuleSet, Seen, changes};
use sm2_node::domain::Domain;
use sm2_proto::Name;
use sm2_proto::gateway::SubjectKind;

use crate::config::{NETWORK, RuleTables};
use crate::domain::{published, served};

/// How many names of the network are remembered. Names beyond that are not compared.
const OFFERS_MAX: usize = 16_384;

/// The rules of another configuration, which are only compared with those in force.
#[derive(Clone, Debug)]
pub struct Shadow {
    rules: RuleTables,
    seen: Seen,
    /// Whether names have come or gone since the last comparison.
    has_changed: bool,
    /// The differences that were reported, and still exist.
    known: BTreeSet<Change>,
}

impl Shadow {
    /// The rules of a configuration that is not in force.
    #[must_use]
    pub fn new(rules: RuleTables) -> Self {
        Self {
            rules,
            seen: Seen::default(),
            has_changed: true,
            known: BTreeSet::new(),
        }
    }

    /// Takes the topics and services of the domain.
    pub fn follow(&mut self, domain: &Domain) {
        let topics = published(domain).into_iter();
        let topics = topics.map(|(name, _)| (SubjectKind::Topic, name));
        let services = served(domain).into_iter();
        let services = services.map(|(name, ..)| (SubjectKind::Service, name));
        let local = topics.chain(services).collect();
        self.has_changed |= mem::replace(&mut self.seen.local, local) != self.seen.local;
    }

    /// Takes a topic or service of the network. It is remembered.
    pub fn note(&mut self, kind: SubjectKind, name: &Name) {
        let offers = self.seen.offers.entry(NETWORK).or_default();
        if offers.len() < OFFERS_MAX {
            self.has_changed |= offers.insert((kind, name.clone()));
        }
    }

    /// Compares with the rules in force. Returns a line for each difference that the last call did not find.
    pub fn compare(&mut self, rules: &RuleTables) -> Vec<String> {
        if !mem::take(&mut self.has_changed) {
            return Vec::new();
        }
        let found = changes(&rule_set(rules), &rule_set(&self.rules), &self.seen);
        let names = BTreeMap::from_iter(Name::new("network").ok().map(|it| (NETWORK, it)));
        let lines: Vec<_> = self.rules.notes.iter().map(|it| it.line).collect();
        let new = found.iter().filter(|it| !self.known.contains(*it));
        let new = new
            .map(|it| ShadowReport::new(it, &names, &lines).to_string())
            .collect();
        self.known = found.into_iter().collect();
        new
    }
}

fn rule_set(rules: &RuleTables) -> RuleSet {
    RuleSet {
        rules: rules.rules.clone(),
        peers: BTreeSet::from([NETWORK]),
    }
}

/// The topics and services of a domain that rules let out, with their lines.
pub(crate) fn lets_out(rules: &RuleTables, domain: &Domain) -> Vec<String> {
    let mut shadow = Shadow::new(rules.clone());
    shadow.follow(domain);
    // Without rules nothing passes, so each name that passes is a difference.
    shadow.compare(&RuleTables::default())
}

#[cfg(test)]
mod tests {
    use sm2_proto::gateway::{Action, Direction, Pattern, Rule, Rules};

    use super::*;
    use crate::config::RuleNote;

    fn rules(all: &[(Action, &str, Direction)]) -> RuleTables {
        let rule = |(action, names, direction): &(Action, &str, Direction)| Rule {
            action: *action,
            kind: None,
            names: Pattern::new(names).unwrap(),
            direction: Some(*direction),
            peers: None,
        };
        let notes = (1..).map(|line| RuleNote {
            line: 10 * line,
            ..RuleNote::default()
        });
        RuleTables {
            rules: Rules(all.iter().map(rule).collect()),
            notes: notes.take(all.len()).collect(),
        }
    }

    #[test]
    fn each_difference_is_reported_once_while_it_exists() {
        let now = rules(&[
            (Action::Allow, "camera/**", Direction::In),
            (Action::Allow, "pose", Direction::In),
        ]);
        let mut shadow = Shadow::new(rules(&[
            (Action::Deny, "camera/raw", Direction::In),
            (Action::Allow, "**", Direction::In),
        ]));
        assert!(shadow.compare(&now).is_empty());
        for name in ["camera/raw", "camera/image", "speed", "speed"] {
            shadow.note(SubjectKind::Topic, &Name::new(name).unwrap());
        }
        assert_eq!(
            shadow.compare(&now),
            [
                "network: topic camera/raw would no longer come in (line 10)",
                "network: topic speed would come in (line 20)"
            ]
        );
        shadow.note(SubjectKind::Service, &Name::new("reset").unwrap());
        assert_eq!(
            shadow.compare(&now),
            ["network: service reset would come in (line 20)"]
        );
        shadow.note(SubjectKind::Service, &Name::new("reset").unwrap());
        assert!(shadow.compare(&now).is_empty());
    }
}
