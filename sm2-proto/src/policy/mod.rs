//! Access rights: which process may publish, subscribe, serve, call, see and read counters under
//! which names. SPEC section 15.
//!
//! | question | answered by |
//! | --- | --- |
//! | may this subject do this? | [`AccessPolicy::decide`] |
//! | may this process give its node that name? | [`AccessPolicy::binding_against`] |
//! | may this topic have a second publisher? | [`AccessPolicy::exclusive`] |
//!
//! All three are pure functions of the policy and their arguments. The Manager calls them for each
//! request, and tools call them to explain a decision. The names of nodes are chosen by the nodes: a
//! rule about a name is a boundary between users only together with a [`Binding`] of that name.
//!
//! The policy has no state, so tests compare it with a naive oracle, and `sm2 policy explain` gives the Manager's own
//! answer. A Manager that cannot read the policy at its start does not serve, so no standby takes over with fewer
//! rules.

mod actions;
mod subject;

use alloc::{collections::BTreeSet, vec::Vec};

pub use self::{
    actions::{Action, ActionSet, UnknownAction},
    subject::{Members, Subject, User},
};
use crate::{
    Name,
    gateway::Pattern,
    limits::{POLICY_TABLES_MAX, POLICY_TERMS_MAX},
};

/// The result of a decision, and the effect of a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Effect {
    /// The subject may do it.
    Allow,
    /// The subject may not do it.
    Deny,
}

/// The position of a rule in its policy, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RuleId(pub usize);

/// One rule. It matches if its actions, its names and all its conditions on the subject match.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Rule {
    /// The name of the rule in refusals.
    pub name: Name,
    /// The effect on a match.
    pub effect: Effect,
    /// The actions to match.
    pub actions: ActionSet,
    /// The names of topics, services or nodes: one of the patterns has to match.
    pub names: Vec<Pattern>,
    /// The users and groups to match.
    pub members: Members,
    /// The names of the subject's node: one of the patterns has to match. `None` matches all.
    pub nodes: Option<Vec<Pattern>>,
    /// The names of the peer of a remote node: one of the patterns has to match. `None` matches no
    /// remote node, unless the rule has no condition on the subject at all.
    pub peers: Option<Vec<Pattern>>,
}

impl Rule {
    /// Whether the rule has no condition on the subject.
    #[must_use]
    pub const fn is_for_all(&self) -> bool {
        self.members.is_all() && self.nodes.is_none() && self.peers.is_none()
    }

    //= SM2-ACC-002, SM2-ACC-003
    fn is_about(&self, subject: &Subject) -> bool {
        let peer_matches = match (&self.peers, subject.peer()) {
            (None, None) => true,
            (None, Some(_)) => self.is_for_all(),
            (Some(_), None) => false,
            (Some(patterns), Some(peer)) => fits_one(patterns, peer),
        };
        let nodes = self.nodes.as_ref();
        peer_matches
            && self.members.has(subject.user())
            && nodes.is_none_or(|it| fits_one(it, subject.node()))
    }

    fn matches(&self, subject: &Subject, action: Action, name: &Name) -> bool {
        self.actions.has(action) && fits_one(&self.names, name) && self.is_about(subject)
    }
}

/// Reserves names of nodes for users.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Binding {
    /// The name of the binding in refusals.
    pub name: Name,
    /// The names of nodes that it reserves.
    pub nodes: Vec<Pattern>,
    /// The users and groups whose processes may use these names.
    pub members: Members,
}

/// Reserves topics for one publisher at a time.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Exclusive {
    /// The name of the entry in refusals.
    pub name: Name,
    /// The topics: each of them has at most one publisher.
    pub topics: Vec<Pattern>,
}

/// The parts of an [`AccessPolicy`]. [`AccessPolicy::new`] checks them.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Tables {
    /// The decision if no rule matches.
    pub default: Effect,
    /// The rules. Their order matters: the first match decides.
    pub rules: Vec<Rule>,
    /// The bindings. Their order matters: the first match decides.
    pub bindings: Vec<Binding>,
    /// The topics that have one publisher.
    pub exclusive: Vec<Exclusive>,
}

/// The access rights of a domain, within the limits of SPEC section 2.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct AccessPolicy(Tables);

/// The answer of [`AccessPolicy::decide`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Decision {
    /// The effect.
    pub effect: Effect,
    /// The rule that decided; `None` if no rule matches and the default decided.
    pub rule: Option<RuleId>,
}

/// Why tables are not an [`AccessPolicy`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolicyError {
    /// There are too many rules, bindings and exclusive entries.
    #[error(
        "a policy has at most {POLICY_TABLES_MAX} rules, bindings and exclusive entries, this one has \
         {0}: join rules that differ only in their names"
    )]
    TooManyTables(usize),
    /// There are too many patterns, users and groups.
    #[error(
        "a policy has at most {POLICY_TERMS_MAX} patterns, users and groups, this one has {0}: use \
         patterns with `*` and `**`, and groups in place of users"
    )]
    TooManyTerms(usize),
    /// Two tables have one name, so a refusal that cites the name would be ambiguous.
    #[error("two rules, bindings or exclusive entries have the name `{0}`: rename one of them")]
    DuplicateName(Name),
}

impl Default for AccessPolicy {
    /// The policy of a domain without a policy file: each action is allowed.
    //= SM2-ACC-007
    fn default() -> Self {
        Self(Tables {
            default: Effect::Allow,
            rules: Vec::new(),
            bindings: Vec::new(),
            exclusive: Vec::new(),
        })
    }
}

impl AccessPolicy {
    /// Checks the limits of SPEC section 2, and that no two tables have one name.
    ///
    /// # Errors
    /// See [`PolicyError`].
    //= SM2-ACC-006
    pub fn new(tables: Tables) -> Result<Self, PolicyError> {
        let Tables {
            default: _,
            rules,
            bindings,
            exclusive,
        } = &tables;
        let count = rules.len() + bindings.len() + exclusive.len();
        if count > POLICY_TABLES_MAX {
            return Err(PolicyError::TooManyTables(count));
        }
        let patterns = |it: &Option<Vec<Pattern>>| it.as_ref().map_or(0, Vec::len);
        let of_rule = |it: &Rule| {
            it.names.len() + it.members.len() + patterns(&it.nodes) + patterns(&it.peers)
        };
        let of_binding = |it: &Binding| it.nodes.len() + it.members.len();
        let terms = rules.iter().map(of_rule).sum::<usize>()
            + bindings.iter().map(of_binding).sum::<usize>()
            + exclusive.iter().map(|it| it.topics.len()).sum::<usize>();
        if terms > POLICY_TERMS_MAX {
            return Err(PolicyError::TooManyTerms(terms));
        }
        let names = rules.iter().map(|it| &it.name);
        let names = names.chain(bindings.iter().map(|it| &it.name));
        let mut seen = BTreeSet::new();
        for name in names.chain(exclusive.iter().map(|it| &it.name)) {
            if !seen.insert(name) {
                return Err(PolicyError::DuplicateName(name.clone()));
            }
        }
        Ok(Self(tables))
    }

    /// Applies the first rule that matches, or the default if none does. `name` is that of the topic
    /// or service; for [`Action::See`] of a node and for [`Action::ReadCounters`], that of the node.
    //= SM2-ACC-001
    #[must_use]
    pub fn decide(&self, subject: &Subject, action: Action, name: &Name) -> Decision {
        let matching = |rule: &Rule| rule.matches(subject, action, name);
        let rule = self.0.rules.iter().position(matching);
        Decision {
            effect: rule.map_or(self.0.default, |index| self.0.rules[index].effect),
            rule: rule.map(RuleId),
        }
    }

    /// The binding that keeps a process of this user from naming its node so; `None` if it may.
    //= SM2-ACC-004
    #[must_use]
    pub fn binding_against(&self, user: &User, node: &Name) -> Option<&Binding> {
        let mut bindings = self.0.bindings.iter();
        let first = bindings.find(|it| fits_one(&it.nodes, node));
        first.filter(|it| !it.members.has(user))
    }

    /// The entry that allows only one publisher on this topic; `None` if several may publish.
    //= SM2-ACC-005
    #[must_use]
    pub fn exclusive(&self, topic: &Name) -> Option<&Exclusive> {
        let mut entries = self.0.exclusive.iter();
        entries.find(|it| fits_one(&it.topics, topic))
    }

    /// The name of a rule of this policy.
    #[must_use]
    pub fn rule_name(&self, rule: RuleId) -> Option<&Name> {
        self.0.rules.get(rule.0).map(|it| &it.name)
    }

    /// All parts of the policy.
    #[must_use]
    pub const fn tables(&self) -> &Tables {
        &self.0
    }
}

fn fits_one(patterns: &[Pattern], name: &Name) -> bool {
    patterns.iter().any(|it| it.fits(name))
}
