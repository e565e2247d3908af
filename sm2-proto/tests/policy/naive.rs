//! A second implementation of access rights: plain texts and lists, simple and slow.

use proptest::{collection::vec, option, prelude::*, sample::select, sample::subsequence};
use sm2_proto::{
    Name,
    gateway::Pattern,
    policy::{
        AccessPolicy, Action, Binding, Effect, Exclusive, Members, Rule, Subject, Tables, User,
    },
};

/// A rule, a binding or an exclusive entry, which use a part of the fields.
#[derive(Clone, Debug)]
struct Line {
    allow: bool,
    actions: Vec<Action>,
    names: Vec<String>,
    users: Option<Vec<u32>>,
    groups: Option<Vec<u32>>,
    nodes: Option<Vec<String>>,
    peers: Option<Vec<String>>,
}

#[derive(Clone, Debug)]
pub(crate) struct Lines {
    default_allows: bool,
    rules: Vec<Line>,
    bindings: Vec<Line>,
    exclusive: Vec<Line>,
}

#[derive(Clone, Debug)]
pub(crate) struct Question {
    uid: u32,
    gids: Vec<u32>,
    node: String,
    pub(crate) action: Action,
    pub(crate) name: String,
}

fn text(words: &'static [&'static str]) -> impl Strategy<Value = String> {
    vec(select(words), 1..4).prop_map(|it| it.join("/"))
}

fn names() -> impl Strategy<Value = Vec<String>> {
    vec(text(&["a", "b", "*", "**"]), 0..3)
}

fn node() -> impl Strategy<Value = String> {
    (any::<bool>(), text(&["a", "b", "remote"])).prop_map(|(remote, it)| match remote {
        true => format!("remote/{it}"),
        false => it,
    })
}

fn ids() -> impl Strategy<Value = Vec<u32>> {
    subsequence(vec![1, 2, 3], 0..=3)
}

fn line() -> impl Strategy<Value = Line> {
    let nodes = prop_oneof![names(), vec(node(), 1..2)];
    let parts = (
        any::<bool>(),
        subsequence(Action::ALL.to_vec(), 1..=6),
        vec(text(&["a", "b", "*", "**"]), 1..3),
        option::weighted(0.3, ids()),
        option::weighted(0.3, ids()),
        option::weighted(0.3, nodes),
        option::weighted(0.3, names()),
    );
    parts.prop_map(
        |(allow, actions, names, users, groups, nodes, peers)| Line {
            allow,
            actions,
            names,
            users,
            groups,
            nodes,
            peers,
        },
    )
}

pub(crate) fn policy() -> impl Strategy<Value = Lines> {
    let parts = (
        any::<bool>(),
        vec(line(), 0..8),
        vec(line(), 0..3),
        vec(line(), 0..3),
    );
    parts.prop_map(|(default_allows, rules, bindings, exclusive)| Lines {
        default_allows,
        rules,
        bindings,
        exclusive,
    })
}

pub(crate) fn question() -> impl Strategy<Value = Question> {
    let parts = (
        1..4_u32,
        ids(),
        node(),
        select(Action::ALL.to_vec()),
        text(&["a", "b"]),
    );
    parts.prop_map(|(uid, gids, node, action, name)| Question {
        uid,
        gids,
        node,
        action,
        name,
    })
}

fn patterns(texts: &[String]) -> Vec<Pattern> {
    texts.iter().map(|it| Pattern::new(it).unwrap()).collect()
}

fn fits(pattern: &[&str], name: &[&str]) -> bool {
    let Some((first, behind)) = pattern.split_first() else {
        return name.is_empty();
    };
    if *first == "**" {
        return (0..=name.len()).any(|taken| fits(behind, &name[taken..]));
    }
    match name.split_first() {
        Some((segment, rest)) => (*first == "*" || first == segment) && fits(behind, rest),
        None => false,
    }
}

fn fits_one(patterns: &[String], name: &str) -> bool {
    let split = |text: &'_ str| text.split('/').map(str::to_owned).collect::<Vec<_>>();
    let name = split(name);
    let name: Vec<&str> = name.iter().map(String::as_str).collect();
    patterns.iter().any(|pattern| {
        let pattern = split(pattern);
        fits(
            &pattern.iter().map(String::as_str).collect::<Vec<_>>(),
            &name,
        )
    })
}

impl Line {
    fn members(&self) -> Members {
        Members {
            users: self.users.clone(),
            groups: self.groups.clone(),
        }
    }

    fn has_user(&self, question: &Question) -> bool {
        if let Some(users) = &self.users
            && !users.contains(&question.uid)
        {
            return false;
        }
        if let Some(groups) = &self.groups
            && !groups.iter().any(|it| question.gids.contains(it))
        {
            return false;
        }
        true
    }

    fn is_about(&self, question: &Question) -> bool {
        if !self.has_user(question) {
            return false;
        }
        if let Some(nodes) = &self.nodes
            && !fits_one(nodes, &question.node)
        {
            return false;
        }
        let conditions = [
            self.users.is_some(),
            self.groups.is_some(),
            self.nodes.is_some(),
        ];
        match (question.node.split_once('/'), &self.peers) {
            (Some(("remote", peer)), Some(peers)) => fits_one(peers, peer),
            (Some(("remote", _)), None) => conditions == [false; 3],
            (_, Some(_)) => false,
            (_, None) => true,
        }
    }
}

impl Lines {
    pub(crate) fn build(&self) -> AccessPolicy {
        let called = |kind: &str, index| Name::new(&format!("{kind}-{index}")).unwrap();
        let effect = |allow| if allow { Effect::Allow } else { Effect::Deny };
        let rules = self.rules.iter().enumerate().map(|(index, line)| Rule {
            name: called("rule", index),
            effect: effect(line.allow),
            actions: line.actions.iter().copied().collect(),
            names: patterns(&line.names),
            members: line.members(),
            nodes: line.nodes.as_deref().map(patterns),
            peers: line.peers.as_deref().map(patterns),
        });
        let bindings = self.bindings.iter().enumerate();
        let bindings = bindings.map(|(index, line)| Binding {
            name: called("binding", index),
            nodes: patterns(&line.names),
            members: line.members(),
        });
        let exclusive = self.exclusive.iter().enumerate();
        let exclusive = exclusive.map(|(index, line)| Exclusive {
            name: called("exclusive", index),
            topics: patterns(&line.names),
        });
        let tables = Tables {
            default: effect(self.default_allows),
            rules: rules.collect(),
            bindings: bindings.collect(),
            exclusive: exclusive.collect(),
        };
        AccessPolicy::new(tables).unwrap()
    }

    /// Returns whether the action is allowed, and the number of the deciding rule.
    pub(crate) fn decide(&self, question: &Question) -> (bool, Option<usize>) {
        for (index, line) in self.rules.iter().enumerate() {
            if line.actions.contains(&question.action)
                && fits_one(&line.names, &question.name)
                && line.is_about(question)
            {
                return (line.allow, Some(index));
            }
        }
        (self.default_allows, None)
    }

    pub(crate) fn binding_against(&self, question: &Question) -> Option<String> {
        for (index, line) in self.bindings.iter().enumerate() {
            if fits_one(&line.names, &question.node) {
                return (!line.has_user(question)).then(|| format!("binding-{index}"));
            }
        }
        None
    }

    pub(crate) fn exclusive(&self, topic: &str) -> Option<String> {
        let index = self
            .exclusive
            .iter()
            .position(|it| fits_one(&it.names, topic));
        index.map(|it| format!("exclusive-{it}"))
    }
}

impl Question {
    pub(crate) fn subject(&self) -> Subject {
        let user = User {
            uid: self.uid,
            gids: self.gids.clone(),
        };
        Subject::new(user, Name::new(&self.node).unwrap())
    }
}
