//! `sm2 why`: explains why two interfaces are linked or not, or lists the nearest counterparts of one.

use std::collections::BTreeSet;

use clap::Args;
use serde::Serialize;
use sm2_io::clock;
use sm2_node::explain::{Finding, Near, Verdict, difference, nearest, why};
use sm2_proto::{
    Contract, EntityId, Instant, Kind, Refusal, TypeId, domain::Domain as Mirror, schema::Schema,
};

use crate::{
    colours::Meaning,
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    interface_troubles::InterfaceTrouble,
    interfaces::InterfaceReport,
    names::{Selector, titles},
    observation::Observation,
    output::Output,
    report::Options,
    sampling::Sample,
    stopped::StoppedNode,
    troubles::LinkTroubles,
    view::View,
};

/// `sm2 why`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// An interface: NODE:NAME of a topic or service, or one name alone if it is unambiguous
    #[arg(value_name = "A", value_parser = Selector::parse)]
    one: Selector,
    /// The other interface [default: the nearest counterparts of A]
    #[arg(value_name = "B", value_parser = Selector::parse)]
    other: Option<Selector>,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
With A alone, why shows the links of A, and the counterparts that nearly match, with the reason why
 they do not. If types differ and their schemas are registered, why names the first field that
differs.

For links, why reads the counters of both nodes: which end has taken nothing for 2 s or more while
messages wait, how many samples it holds, which messages were longer than a subscriber accepts, which
node is short of memory, and which one is stopped. If messages were dropped or deadlines missed before,
why reads the counters again a second later, and shows what was lost or missed in between.

Exit status: 0 linked, 1 not linked (or there is no such interface), 2 wrong usage, 3 linked, but not
working: an end takes nothing, a deadline is being missed, or a node is stopped or short of memory.

Examples:
  sm2 why talker:scan listener:scan
  sm2 why talker listener
  sm2 why scan
  sm2 why talker listener --json | jq .verdict.finding";

/// The largest number of pairs that are searched for similar names.
const PAIRS_MAX: usize = 1_024;

/// The object that `--json` prints for two interfaces.
#[derive(Serialize)]
pub(crate) struct Pair {
    /// The domain's revision.
    revision: u64,
    linked: bool,
    /// Whether messages get through; false if the two are not linked.
    working: bool,
    verdict: Verdict,
    /// The first differences of the types, for an interface that was refused for its type. Empty if their
    /// schemas are not registered.
    differences: Vec<String>,
    #[serde(flatten)]
    problems: Problems,
    /// The verdict as text.
    text: String,
}

/// The object that `--json` prints for one name.
#[derive(Serialize)]
pub(crate) struct Around {
    /// The domain's revision.
    revision: u64,
    /// Whether every interface has a link.
    linked: bool,
    /// Whether every interface has a link, and messages get through on all links.
    working: bool,
    #[serde(flatten)]
    problems: Problems,
    interfaces: Vec<One>,
}

/// The problems of some interfaces and their links.
#[derive(Serialize)]
struct Problems {
    /// The nodes of the interfaces that are stopped. For one name, also those that its interfaces are linked with.
    stopped: Vec<StoppedNode>,
    /// The troubles on the links of the interfaces.
    #[serde(flatten)]
    troubles: LinkTroubles,
    /// The messages that the interfaces published to nobody.
    unheard: Vec<InterfaceTrouble>,
}

/// An interface, its links, and its nearest counterparts.
#[derive(Serialize)]
struct One {
    interface: InterfaceReport,
    linked_with: Vec<String>,
    near: Vec<Near>,
}

/// The answer to a question: the object that `--json` prints.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum Answer {
    Pair(Box<Pair>),
    Around(Box<Around>),
}

/// Runs the command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.options.domain, "why")?;
    let wait = |until| Ok(!command_node.pause(until)?);
    let answer = Answer::find(
        &command_node,
        &arguments.one,
        arguments.other.as_ref(),
        wait,
    )?;
    command_node.fail_if_stopped()?;
    Output::new().answer(arguments.options.json, &answer, |out| answer.print(out))?;
    Ok(match answer.is_linked_and_working() {
        (false, _) => Ended::No,
        (true, false) => Ended::NotWorking,
        (true, true) => Ended::Done,
    })
}

impl Answer {
    /// Asks the Manager for the domain, and explains the links of `one`, or why it is linked with `other` or not.
    /// `wait` is that of [`Observation::make`].
    ///
    /// # Errors
    ///
    /// Those of [`CommandNode::snapshot`] and of [`Selector::entities`], [`CliError::Ambiguous`].
    pub(crate) fn find(
        command_node: &CommandNode,
        one: &Selector,
        other: Option<&Selector>,
        wait: impl FnOnce(Instant) -> Result<bool, CliError>,
    ) -> Result<Self, CliError> {
        let domain = command_node.snapshot()?;
        let view = View::new(&domain);
        Ok(match other {
            Some(other) => Self::Pair(Box::new(Pair::find(
                command_node,
                &view,
                [one, other],
                wait,
            )?)),
            None => Self::Around(Box::new(Around::find(command_node, &view, one, wait)?)),
        })
    }

    /// The answer as text.
    pub(crate) fn lines(&self) -> Vec<String> {
        match self {
            Self::Pair(pair) => pair.lines(),
            Self::Around(around) => around.lines(),
        }
    }

    /// Prints the answer. The first line about two interfaces is the verdict.
    fn print(&self, out: &mut Output) -> Result<(), CliError> {
        let lines = self.lines();
        let mut lines = lines.iter();
        if let (Self::Pair(_), Some(first)) = (self, lines.as_slice().first()) {
            let meaning = match self.is_linked_and_working() {
                (false, _) => Meaning::Bad,
                (true, false) => Meaning::Warning,
                (true, true) => Meaning::Good,
            };
            out.meant(meaning, first.len(), first)?;
            lines.next();
        }
        lines.try_for_each(|it| out.sentence(it))
    }

    const fn is_linked_and_working(&self) -> (bool, bool) {
        match self {
            Self::Pair(pair) => (pair.linked, pair.working),
            Self::Around(around) => (around.linked, around.working),
        }
    }
}

impl Pair {
    fn find(
        command_node: &CommandNode,
        view: &View<'_>,
        [one, other]: [&Selector; 2],
        wait: impl FnOnce(Instant) -> Result<bool, CliError>,
    ) -> Result<Self, CliError> {
        let domain = view.domain;
        let (one, other) = pair(view, one, other)?;
        let verdict = explain(command_node, why(domain, one, other));
        let stopped = stopped_nodes(domain, [one, other]);
        let problems = Problems::find(command_node, view, &[one, other], stopped, wait);
        let linked = verdict.is_linked();
        Ok(Self {
            revision: domain.revision(),
            linked,
            working: linked && problems.is_working(),
            problems,
            text: verdict.to_string(),
            differences: differences(command_node, domain, &verdict),
            verdict,
        })
    }

    fn lines(&self) -> Vec<String> {
        let mut lines: Vec<_> = self.text.lines().map(str::to_owned).collect();
        lines.extend(self.differences.iter().cloned());
        lines.extend(self.problems.lines());
        lines
    }
}

impl Around {
    fn find(
        command_node: &CommandNode,
        view: &View<'_>,
        of: &Selector,
        wait: impl FnOnce(Instant) -> Result<bool, CliError>,
    ) -> Result<Self, CliError> {
        let domain = view.domain;
        let entities = of.entities(view)?;
        let stopped = stopped_nodes(domain, with_peers(view, &entities));
        let problems = Problems::find(command_node, view, &entities, stopped, wait);
        let interfaces = entities
            .into_iter()
            .map(|entity| one(command_node, view, entity));
        let interfaces: Vec<_> = interfaces.flatten().collect();
        let linked = interfaces.iter().all(|it| !it.linked_with.is_empty());
        Ok(Self {
            revision: domain.revision(),
            linked,
            working: linked && problems.is_working(),
            problems,
            interfaces,
        })
    }

    fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for it in &self.interfaces {
            let InterfaceReport {
                node, kind, name, ..
            } = &it.interface;
            let linked_with = match &*it.linked_with {
                [] => "nobody".to_owned(),
                some => some.join(", "),
            };
            lines.push(format!(
                "{node}'s {kind} of {name} is linked with {linked_with}."
            ));
            for near in &it.near {
                lines.extend(near.to_string().lines().map(|line| format!("  {line}")));
            }
            if it.near.is_empty() && it.linked_with.is_empty() {
                let none = "  This domain has no counterpart with this name or a similar one.";
                lines.push(none.into());
            }
        }
        lines.extend(self.problems.lines());
        lines
    }
}

impl Problems {
    /// Reads the counters of these interfaces, and of those that they are linked with. An answer is complete without
    /// counters.
    fn find(
        command_node: &CommandNode,
        view: &View<'_>,
        of: &[EntityId],
        stopped: Vec<StoppedNode>,
        wait: impl FnOnce(Instant) -> Result<bool, CliError>,
    ) -> Self {
        let nodes = with_peers(view, of).map(|it| it.node).collect();
        let observed = Observation::make(&command_node.node, view.domain, &nodes, wait);
        let observation =
            observed.unwrap_or_else(|_| Observation::once(Sample::new(clock::now(), [])));
        let readings = observation.readings();
        Self {
            stopped,
            troubles: LinkTroubles::find(view, readings, of),
            unheard: InterfaceTrouble::unheard(view, readings.now, of),
        }
    }

    /// Whether messages get through on all links nevertheless.
    fn is_working(&self) -> bool {
        self.stopped.is_empty() && self.troubles.is_working()
    }

    fn lines(&self) -> impl Iterator<Item = String> {
        let unheard = self.unheard.iter().map(|it| format!("Note: {it}."));
        let stopped = self.stopped.iter().map(|node| {
            let remedy = node.remedy();
            format!("But {node}, so no message gets through: {remedy}.")
        });
        unheard.chain(self.troubles.lines()).chain(stopped)
    }
}

/// A verdict with the first difference of the types. The verdict is complete without their schemas.
fn explain(command_node: &CommandNode, verdict: Verdict) -> Verdict {
    verdict.with_schemas(|data| command_node.describe(data).ok().flatten())
}

/// The first difference of each pair of a refused type and the type in use. (For interfaces that were not
/// refused, the verdict names the difference.)
fn differences(command_node: &CommandNode, domain: &Mirror, verdict: &Verdict) -> Vec<String> {
    let Finding::Refused { entity, reason, .. } = &verdict.finding else {
        return Vec::new();
    };
    let Some(refused) = domain.interface(*entity) else {
        return Vec::new();
    };
    let pairs = match (refused.contract, reason) {
        (
            Contract::Publisher { data, .. }
            | Contract::Subscriber {
                data: Some(data), ..
            },
            Refusal::TopicType { theirs },
        ) => vec![(data, theirs)],
        (
            Contract::Server { request, reply, .. }
            | Contract::Client {
                types: Some((request, reply)),
                ..
            },
            Refusal::ServiceType {
                request: asks,
                reply: expects,
            },
        ) => vec![(request, asks), (reply, expects)],
        _ => Vec::new(),
    };
    // The verdict is complete without schemas.
    let schema = |data: &TypeId| Schema::parse(&command_node.describe(data).ok()??).ok();
    let difference = |(ours, theirs): (&TypeId, &TypeId)| {
        let difference = difference(&schema(ours)?, &schema(theirs)?)?;
        Some(format!(
            "First difference of {} (here: what was refused, there: what is in use): {difference}.",
            ours.name
        ))
    };
    pairs.into_iter().filter_map(difference).collect()
}

/// The two interfaces that two names stand for.
///
/// # Errors
///
/// [`CliError::Unknown`], [`CliError::NoInterfaces`], [`CliError::Ambiguous`].
fn pair(
    view: &View<'_>,
    one: &Selector,
    other: &Selector,
) -> Result<(EntityId, EntityId), CliError> {
    let (mut ours, mut theirs) = (one.entities(view)?, other.entities(view)?);
    if named_alike(view, &counterparts(view, &ours, &theirs)).is_empty() {
        let (all_ours, all_theirs) = (one.with_node(view, &ours), other.with_node(view, &theirs));
        if !named_alike(view, &counterparts(view, &all_ours, &all_theirs)).is_empty() {
            (ours, theirs) = (all_ours, all_theirs);
        }
    }
    if let ([one], [other]) = (&*ours, &*theirs) {
        return Ok((*one, *other));
    }
    let pairs = likeliest(view, counterparts(view, &ours, &theirs));
    match &*pairs {
        [pair] => Ok(*pair),
        _ => {
            let (text, entities) = match ours.len() > 1 {
                true => (one, ours),
                false => (other, theirs),
            };
            Err(CliError::Ambiguous {
                text: text.to_string(),
                candidates: titles(view, entities),
            })
        }
    }
}

/// All pairs of an interface and a counterpart, each once.
fn counterparts(
    view: &View<'_>,
    ours: &[EntityId],
    theirs: &[EntityId],
) -> Vec<(EntityId, EntityId)> {
    let kind = |entity| view.domain.interface(entity).map(|it| it.contract.kind());
    let all = ours
        .iter()
        .flat_map(|&one| theirs.iter().map(move |&other| (one, other)));
    let fitting = all.filter(|&(one, other)| kind(one).map(Kind::counterpart) == kind(other));
    let each_once: BTreeSet<_> = fitting
        .map(|(one, other)| (one.min(other), one.max(other)))
        .collect();
    each_once.into_iter().collect()
}

/// The pairs with equal names.
fn named_alike(view: &View<'_>, pairs: &[(EntityId, EntityId)]) -> Vec<(EntityId, EntityId)> {
    let name = |entity| view.domain.interface(entity).map(|it| it.contract.name());
    let same = |&(one, other): &(EntityId, EntityId)| name(one) == name(other);
    pairs.iter().copied().filter(same).collect()
}

/// The pairs with equal names, else the pairs with similar names, else all pairs.
fn likeliest(view: &View<'_>, pairs: Vec<(EntityId, EntityId)>) -> Vec<(EntityId, EntityId)> {
    let named = named_alike(view, &pairs);
    if !named.is_empty() {
        return named;
    }
    // Each verdict takes time, and of so many pairs none can be meant.
    if pairs.len() > PAIRS_MAX {
        return pairs;
    }
    let is_near = |&(one, other): &(EntityId, EntityId)| {
        let finding = why(view.domain, one, other).finding;
        matches!(finding, Finding::Names { near: Some(_) })
    };
    let near: Vec<_> = pairs.iter().copied().filter(is_near).collect();
    match near.is_empty() {
        true => pairs,
        false => near,
    }
}

fn one(command_node: &CommandNode, view: &View<'_>, entity: EntityId) -> Option<One> {
    let peers = view
        .links_of(entity)
        .iter()
        .map(|link| match link.offering == entity {
            true => link.demanding,
            false => link.offering,
        });
    let near = nearest(view.domain, entity).into_iter().map(|near| Near {
        verdict: explain(command_node, near.verdict),
        ..near
    });
    Some(One {
        interface: InterfaceReport::new(view, view.domain.interface(entity)?),
        linked_with: peers.map(|peer| view.title(peer)).collect(),
        near: near.collect(),
    })
}

/// These interfaces, and those that they are linked with.
fn with_peers(view: &View<'_>, of: &[EntityId]) -> impl Iterator<Item = EntityId> {
    let links = of.iter().flat_map(|it| view.links_of(*it));
    let peers = links.flat_map(|link| [link.offering, link.demanding]);
    of.iter().copied().chain(peers)
}

/// The nodes of these interfaces that are stopped, each once.
fn stopped_nodes(
    domain: &Mirror,
    entities: impl IntoIterator<Item = EntityId>,
) -> Vec<StoppedNode> {
    let nodes: BTreeSet<_> = entities.into_iter().map(|it| it.node).collect();
    let nodes = nodes.into_iter().filter_map(|node| domain.node(node));
    nodes.filter_map(|node| StoppedNode::find(&node)).collect()
}
