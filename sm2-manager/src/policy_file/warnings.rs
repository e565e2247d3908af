//! Parts of a policy that probably do not do what their author expects.

use sm2_proto::{
    Name,
    gateway::Pattern,
    policy::{ActionSet, Binding, Effect, Rule, Tables},
};

use super::error::PolicyWarning;

/// The warnings about tables whose rules are in these lines.
pub(super) fn of(tables: &Tables, rule_lines: &[usize]) -> Vec<PolicyWarning> {
    let mut warnings = Vec::new();
    let mut last: Option<&Rule> = None;
    for (rule, &line) in tables.rules.iter().zip(rule_lines) {
        if let Some(earlier) = last {
            warnings.push(PolicyWarning::NeverReached {
                rule: rule.name.clone(),
                line,
                earlier: earlier.name.clone(),
            });
            continue;
        }
        let unbound = unbound_names(rule, &tables.bindings);
        warnings.extend(unbound.map(|pattern| PolicyWarning::UnboundName {
            rule: rule.name.clone(),
            line,
            pattern,
        }));
        let has_all_names = rule.names.iter().any(|it| it.as_str() == "**");
        if rule.is_for_all() && rule.actions == ActionSet::ALL && has_all_names {
            last = Some(rule);
        }
    }
    warnings
}

/// The patterns of node names that a rule gives rights to, although any user may choose such a name.
fn unbound_names(rule: &Rule, bindings: &[Binding]) -> impl Iterator<Item = String> {
    let nodes = rule.nodes.iter().flatten();
    let nodes = nodes.map(|it| it.as_str().to_owned());
    let peers = rule.peers.iter().flatten();
    let peers = peers.map(|it| format!("remote/{it}"));
    let gives_rights = rule.effect == Effect::Allow && rule.members.is_all();
    // With `**` the name does not matter.
    nodes.chain(peers).filter(move |pattern| {
        gives_rights && pattern != "**" && !bindings.iter().any(|it| covers(it, pattern))
    })
}

/// Whether a binding reserves the names of a pattern: the same pattern, or a name that matches.
fn covers(binding: &Binding, pattern: &str) -> bool {
    let name = Name::new(pattern).ok();
    let covers =
        |it: &Pattern| it.as_str() == pattern || name.as_ref().is_some_and(|name| it.fits(name));
    !binding.members.is_all() && binding.nodes.iter().any(covers)
}
