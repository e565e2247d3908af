//! Names on the command line: the interfaces that they stand for, and hints for unknown names.

use std::{collections::BTreeSet, fmt};

use sm2_bag::Pattern;
use sm2_proto::{EntityId, Name, domain::InterfaceView};

use crate::{error::CliError, view::View};

/// The largest number of names that a message lists.
const SHOWN: usize = 8;

/// The error for a topic, service or node that does not exist, with a hint to a similar name.
pub(crate) fn unknown<'a>(
    what: &'static str,
    name: &Name,
    known: impl IntoIterator<Item = &'a Name>,
) -> CliError {
    CliError::Unknown {
        what,
        name: name.to_string(),
        hint: hint(name.as_str(), known),
    }
}

/// `; did you mean scan?`, or nothing.
pub(crate) fn hint<'a>(name: &str, known: impl IntoIterator<Item = &'a Name>) -> String {
    hint_of(name, known.into_iter().map(Name::as_str))
}

/// As [`hint`], for names of any kind.
pub(crate) fn hint_of<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let mut similar: Vec<_> = known
        .into_iter()
        .filter_map(|it| Some((similarity(name, it)?, it)))
        .collect();
    similar.sort_unstable();
    match similar.first() {
        Some((_, first)) => format!("; did you mean {first}?"),
        None => String::new(),
    }
}

/// As [`hint`], for a glob: the segments that do not match are compared.
pub(crate) fn pattern_hint<'a>(pattern: &str, known: impl IntoIterator<Item = &'a Name>) -> String {
    if !Pattern::is_glob(pattern) {
        return hint(pattern, known);
    }
    let distance = |name: &Name| {
        let pairs = pattern.split('/').zip(name.as_str().split('/'));
        let matches = |its: &str, name| Pattern::glob(its).is_ok_and(|it| it.matches(name));
        let filled = pairs.map(|(its, name)| match matches(its, name) {
            true => name,
            false => its,
        });
        let filled: Vec<_> = filled.collect();
        strsim::osa_distance(&filled.join("/"), name.as_str())
    };
    let segments = |name: &str| name.split('/').count();
    let has_as_many = |it: &&Name| segments(it.as_str()) == segments(pattern);
    let near = known.into_iter().filter(has_as_many);
    let near = near.map(|it| (distance(it), it));
    match near.filter(|it| it.0 <= 2.min(pattern.len() / 2)).min() {
        Some((_, name)) => format!("; did you mean {name}?"),
        None => String::new(),
    }
}

/// The edit distance of two names; `None` if they are not similar.
fn similarity(typed: &str, known: &str) -> Option<usize> {
    let last = |name: &str| name.rsplit('/').next().map(str::to_lowercase);
    if last(typed) == last(known) {
        return Some(0);
    }
    let distance = strsim::osa_distance(&typed.to_lowercase(), &known.to_lowercase());
    (distance <= 2.min(typed.len() / 2)).then_some(distance)
}

/// A name for one or more interfaces on the command line: `talker:scan`, `talker`, `scan`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Selector {
    node: Option<Name>,
    /// A topic or service. Without `node`, it may also be a node.
    name: Name,
}

impl Selector {
    /// Parses a selector.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let read = |text: &str| crate::args::name(text);
        match text.split_once(':') {
            Some((node, name)) => Ok(Self {
                node: Some(read(node)?),
                name: read(name)?,
            }),
            None => Ok(Self {
                node: None,
                name: read(text)?,
            }),
        }
    }

    /// All interfaces that the selector stands for, granted or refused.
    ///
    /// # Errors
    ///
    /// [`CliError::Unknown`] if there is none, [`CliError::NotOfNode`] if it is none of the node, and
    /// [`CliError::NoInterfaces`] for a node without any.
    pub(crate) fn entities(&self, view: &View<'_>) -> Result<Vec<EntityId>, CliError> {
        let domain = view.domain;
        let entities = domain.find(&self.to_string());
        if !entities.is_empty() {
            return Ok(entities);
        }
        let interfaces = || domain.interfaces().map(|it| it.contract.name());
        let nodes = || domain.nodes().map(|node| node.name);
        match &self.node {
            None if domain.node_named(self.name.as_str()).is_some() => {
                let node = self.name.to_string();
                Err(CliError::NoInterfaces { node })
            }
            None => {
                let known = interfaces().chain(nodes());
                Err(unknown("topic, service or node", &self.name, known))
            }
            Some(node) if domain.node_named(node.as_str()).is_none() => {
                Err(unknown("node", node, nodes()))
            }
            Some(node) => Err(CliError::NotOfNode {
                node: node.to_string(),
                name: self.name.to_string(),
                found: found(view, node, &self.name),
            }),
        }
    }

    /// As [`entities`](Self::entities), which are `found`; and if a topic or service and a node have the name, also the
    /// interfaces of the node.
    pub(crate) fn with_node(&self, view: &View<'_>, found: &[EntityId]) -> Vec<EntityId> {
        let domain = view.domain;
        let node = match &self.node {
            None => domain.node_named(self.name.as_str()),
            Some(_) => None,
        };
        let of_node = node
            .into_iter()
            .flat_map(|it| domain.interfaces_of(it.node));
        let of_node = of_node.map(|it| it.entity);
        let all: BTreeSet<_> = found.iter().copied().chain(of_node).collect();
        all.into_iter().collect()
    }
}

/// The interfaces that a name may stand for if it is none of the node: those of other nodes, and those of this one.
/// `: map is the publisher of mapper; listener has the subscriber of scan`.
fn found(view: &View<'_>, node: &Name, name: &Name) -> String {
    let of_node = |it: &InterfaceView<'_>| view.name_of(it.entity.node) == node.as_str();
    let all = || view.domain.interfaces();
    let others = all().filter(|it| it.contract.name() == name);
    let others = others.map(|it| {
        let (kind, node) = (it.contract.kind(), view.name_of(it.entity.node));
        format!("the {kind} of {node}")
    });
    let own = all().filter(of_node);
    let own = own.map(|it| format!("the {} of {}", it.contract.kind(), it.contract.name()));
    let parts = [
        (format!("{name} is"), listed(others)),
        (format!("{node} has"), listed(own)),
    ];
    let parts = parts.into_iter().filter(|(_, listed)| !listed.is_empty());
    let parts: Vec<_> = parts
        .map(|(start, listed)| format!("{start} {listed}"))
        .collect();
    match parts.is_empty() {
        true => String::new(),
        false => format!(": {}", parts.join("; ")),
    }
}

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.node {
            Some(node) => write!(f, "{node}:{}", self.name),
            None => self.name.fmt(f),
        }
    }
}

/// The titles of several interfaces, as text.
pub(crate) fn titles(view: &View<'_>, entities: impl IntoIterator<Item = EntityId>) -> String {
    listed(entities.into_iter().map(|it| view.title(it)))
}

/// Texts in order, each once, as one text. Of very many, the first are named.
fn listed(texts: impl IntoIterator<Item = String>) -> String {
    let mut texts: Vec<_> = texts.into_iter().collect();
    texts.sort_unstable();
    texts.dedup();
    let more = texts.len().saturating_sub(SHOWN);
    texts.truncate(SHOWN);
    match more {
        0 => texts.join(", "),
        more => format!("{} and {more} more", texts.join(", ")),
    }
}

#[cfg(test)]
mod tests;
