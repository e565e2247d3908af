//! The access policies that a scope may have.

use sm2_proto::{
    Contract, Kind, Name,
    gateway::Pattern,
    policy::{AccessPolicy, Action as Does, Effect, Exclusive, Members, Rule, Tables},
};

/// The access policy of a scope, by the interfaces that it denies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Restriction {
    /// Nobody may subscribe.
    NoSubscriber,
    /// Each topic has one publisher.
    OnePublisher,
}

impl Restriction {
    /// The policy.
    pub(super) fn policy(self) -> AccessPolicy {
        let name = Name::new("restriction").expect("a legal name");
        let everything = vec![Pattern::new("**").expect("a legal pattern")];
        let mut tables = Tables {
            default: Effect::Allow,
            rules: Vec::new(),
            bindings: Vec::new(),
            exclusive: Vec::new(),
        };
        match self {
            Self::NoSubscriber => tables.rules.push(Rule {
                name,
                effect: Effect::Deny,
                actions: [Does::Subscribe].into_iter().collect(),
                names: everything,
                members: Members::default(),
                nodes: None,
                peers: None,
            }),
            Self::OnePublisher => tables.exclusive.push(Exclusive {
                name,
                topics: everything,
            }),
        }
        AccessPolicy::new(tables).expect("a small policy")
    }

    /// Whether an interface may have to be suspended.
    pub(super) fn is_about(self, contract: &Contract) -> bool {
        contract.kind()
            == match self {
                Self::NoSubscriber => Kind::Subscriber,
                Self::OnePublisher => Kind::Publisher,
            }
    }

    /// Whether this many interfaces of those that it is about may be live.
    pub(super) fn allows(self, live: usize) -> bool {
        match self {
            Self::NoSubscriber => live == 0,
            Self::OnePublisher => live <= 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restriction_says_how_many_interfaces_may_be_live() {
        let allowed = |it: Restriction| [0, 1, 2, 3].map(|live| it.allows(live));
        assert_eq!(
            allowed(Restriction::NoSubscriber),
            [true, false, false, false]
        );
        assert_eq!(
            allowed(Restriction::OnePublisher),
            [true, true, false, false]
        );
    }
}
