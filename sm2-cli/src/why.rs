//! `sm2 why`: explains why two interfaces are linked or not, or lists the nearest counterparts of one.

mod link_troubles;

use std::collections::BTreeSet;

use clap::Args;
use serde::Serialize;
use sm2_proto::{
    Contract, EntityId, Kind, Refusal, TypeId,
    domain::{Domain as Mirror, Finding, Near, Verdict, nearest, why},
    schema::Schema,
};

use self::link_troubles::LinkTroubles;
use crate::{
    args::Domain,
    connect::Session,
    ended::Ended,
    error::CliError,
    interfaces::Interface,
    names::{Selector, titles},
    output::Output,
    sampling::Sample,
    stopped::StoppedNode,
    unheard::Unheard,
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
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
With A alone, why shows the links of A, and the counterparts that nearly match, with the reason for
which they do not. If types differ and their schemas are registered, why names the first field that
differs. If a node is stopped, why says how to continue it. If messages were longer than a subscriber
accepts, why says how many. If a node is short of memory on a link, why says for how long.

Exit status: 0 linked, 1 not linked (or there is no such interface), 2 wrong usage.

Examples:
  sm2 why talker:scan listener:scan
  sm2 why talker listener
  sm2 why scan
  sm2 why talker listener --json | jq .verdict.finding";

/// The largest number of pairs that are searched for similar names.
const PAIRS_MAX: usize = 1_024;

/// The object that `--json` prints for two interfaces.
#[derive(Serialize)]
struct Pair {
    /// The domain's revision.
    revision: u64,
    linked: bool,
    verdict: Verdict,
    /// The first differences of the types, for an interface that was refused for its type. Empty if their
    /// schemas are not registered.
    differences: Vec<String>,
    /// The nodes of the two interfaces that are stopped.
    stopped: Vec<StoppedNode>,
    /// The troubles on the links of the two interfaces.
    #[serde(flatten)]
    troubles: LinkTroubles,
    /// The messages that one of them published to nobody.
    unheard: Vec<Unheard>,
    /// The verdict as text.
    text: String,
}

/// The object that `--json` prints for one name.
#[derive(Serialize)]
struct Around {
    /// The domain's revision.
    revision: u64,
    /// Whether every interface has a link.
    linked: bool,
    /// The nodes of the interfaces, and of those that they are linked with, that are stopped.
    stopped: Vec<StoppedNode>,
    /// The troubles on the links of the interfaces.
    #[serde(flatten)]
    troubles: LinkTroubles,
    /// The messages that the interfaces published to nobody.
    unheard: Vec<Unheard>,
    interfaces: Vec<One>,
}

/// An interface, its links, and its nearest counterparts.
#[derive(Serialize)]
struct One {
    interface: Interface,
    linked_with: Vec<String>,
    near: Vec<Near>,
}

/// Runs the command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "why")?;
    let domain = session.snapshot()?;
    let view = View::new(&domain);
    let explain = |verdict: Verdict| {
        // The verdict is complete without schemas.
        verdict.with_schemas(|data| session.describe(data).ok().flatten())
    };
    let mut out = Output::new();
    let linked = match &arguments.other {
        Some(other) => {
            let (one, other) = pair(&view, &arguments.one, other)?;
            let verdict = explain(why(&domain, one, other));
            let sample = sample_around(&session, &view, &[one, other]);
            let pair = Pair {
                revision: domain.revision(),
                linked: verdict.is_linked(),
                stopped: stopped_nodes(&domain, [one, other]),
                troubles: LinkTroubles::find(&view, &sample, &[one, other]),
                unheard: Unheard::find(&view, &sample, &[one, other]),
                text: verdict.to_string(),
                differences: differences(&session, &domain, &verdict),
                verdict,
            };
            if arguments.json {
                out.json(&pair)?;
            } else {
                out.line(&pair.text)?;
                for difference in &pair.differences {
                    out.line(difference)?;
                }
                print_unheard(&pair.unheard, &mut out)?;
                print_stopped(&pair.stopped, &mut out)?;
                pair.troubles.print(&mut out)?;
            }
            pair.linked
        }
        None => {
            let entities = arguments.one.entities(&view)?;
            let stopped = stopped_nodes(&domain, with_peers(&view, &entities));
            let sample = sample_around(&session, &view, &entities);
            let troubles = LinkTroubles::find(&view, &sample, &entities);
            let unheard = Unheard::find(&view, &sample, &entities);
            let interfaces = entities
                .into_iter()
                .map(|entity| one(&view, entity, &explain));
            let interfaces: Vec<_> = interfaces.flatten().collect();
            let around = Around {
                revision: domain.revision(),
                linked: interfaces.iter().all(|it| !it.linked_with.is_empty()),
                stopped,
                troubles,
                unheard,
                interfaces,
            };
            match arguments.json {
                true => out.json(&around)?,
                false => print(&around, &mut out)?,
            }
            around.linked
        }
    };
    out.flush()?;
    Ok(if linked { Ended::Done } else { Ended::No })
}

/// The first difference of each pair of a refused type and the type in use. (For interfaces that were not
/// refused, the verdict names the difference.)
fn differences(session: &Session, domain: &Mirror, verdict: &Verdict) -> Vec<String> {
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
    let schema = |data: &TypeId| Schema::parse(&session.describe(data).ok()??).ok();
    let difference = |(ours, theirs): (&TypeId, &TypeId)| {
        let difference = schema(ours)?.difference(&schema(theirs)?)?;
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
    let (ours, theirs) = (one.entities(view)?, other.entities(view)?);
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

/// The pairs with equal names, else the pairs with similar names, else all pairs.
fn likeliest(view: &View<'_>, pairs: Vec<(EntityId, EntityId)>) -> Vec<(EntityId, EntityId)> {
    let name = |entity| view.domain.interface(entity).map(|it| it.contract.name());
    let same = |&(one, other): &(EntityId, EntityId)| name(one) == name(other);
    let named: Vec<_> = pairs.iter().copied().filter(same).collect();
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

fn one(view: &View<'_>, entity: EntityId, explain: &impl Fn(Verdict) -> Verdict) -> Option<One> {
    let peers = view
        .links_of(entity)
        .iter()
        .map(|link| match link.offering == entity {
            true => link.demanding,
            false => link.offering,
        });
    let near = nearest(view.domain, entity).into_iter().map(|near| Near {
        verdict: explain(near.verdict),
        ..near
    });
    Some(One {
        interface: Interface::new(view, view.domain.interface(entity)?),
        linked_with: peers.map(|peer| view.title(peer)).collect(),
        near: near.collect(),
    })
}

fn print(around: &Around, out: &mut Output) -> Result<(), CliError> {
    for it in &around.interfaces {
        let Interface {
            node, kind, name, ..
        } = &it.interface;
        let linked_with = match &*it.linked_with {
            [] => "nobody".to_owned(),
            some => some.join(", "),
        };
        out.line(format_args!(
            "{node}'s {kind} of {name} is linked with {linked_with}."
        ))?;
        for near in &it.near {
            for line in near.to_string().lines() {
                out.line(format_args!("  {line}"))?;
            }
        }
        if it.near.is_empty() && it.linked_with.is_empty() {
            out.line("  This domain has no counterpart with this name or a similar one.")?;
        }
    }
    print_unheard(&around.unheard, out)?;
    print_stopped(&around.stopped, out)?;
    around.troubles.print(out)
}

/// These interfaces, and those that they are linked with.
fn with_peers(view: &View<'_>, of: &[EntityId]) -> impl Iterator<Item = EntityId> {
    let links = of.iter().flat_map(|it| view.links_of(*it));
    let peers = links.flat_map(|link| [link.offering, link.demanding]);
    of.iter().copied().chain(peers)
}

/// The counters of these interfaces, and of those that they are linked with. A verdict is complete without them.
fn sample_around(session: &Session, view: &View<'_>, of: &[EntityId]) -> Sample {
    let nodes = with_peers(view, of).map(|it| it.node).collect();
    Sample::if_known(&session.node, view.domain, &nodes)
}

fn print_unheard(unheard: &[Unheard], out: &mut Output) -> Result<(), CliError> {
    for publisher in unheard {
        out.line(format_args!("Note: {publisher}."))?;
    }
    Ok(())
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

fn print_stopped(stopped: &[StoppedNode], out: &mut Output) -> Result<(), CliError> {
    for node in stopped {
        let remedy = node.remedy();
        out.line(format_args!(
            "But {node}, so no message gets through: {remedy}."
        ))?;
    }
    Ok(())
}
