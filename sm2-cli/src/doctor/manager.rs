//! Checks of the Manager at the socket, and of the state of its domain.

use std::{collections::BTreeSet, os::fd::AsFd, path::Path};

use sm2_io::{SeqPacket, clock};
use sm2_node::{ConnectError, Node};
use sm2_proto::domain::Domain as Mirror;

use super::{check::Check, connections};
use crate::{
    args::Domain,
    connect::drive,
    error::CliError,
    interrupt::Interrupt,
    limits::{LimitsInForce, NEAR_PERCENT, Quota, quotas},
    observation::Observation,
    stopped::StoppedNode,
    troubles::{LinkTroubles, Losing, NotTaking},
    view::View,
    wait::For,
};

/// The start of the node names of standby Managers.
const STANDBY: &str = "sm2/standby/";

/// The state of the Manager and its domain.
pub(super) struct Found {
    pub(super) checks: Vec<Check>,
    /// The number of nodes in the domain, if it is known.
    pub(super) nodes: Option<u64>,
    /// The limits in force, if they are known.
    pub(super) limits: Option<LimitsInForce>,
    /// The use of the limits.
    pub(super) quotas: Vec<Quota>,
}

impl Found {
    /// Only checks: the domain is not known.
    const fn only(checks: Vec<Check>) -> Self {
        Self {
            checks,
            nodes: None,
            limits: None,
            quotas: Vec::new(),
        }
    }
}

pub(super) fn look(options: &Domain, path: &Path, interrupt: &Interrupt) -> Found {
    const CHECK: &str = "Manager";
    // Before the session starts: the kernel names the process even if it does not answer.
    let who = SeqPacket::connect(path).and_then(|socket| socket.peer_credentials());
    let who = match who {
        Ok(who) => format!("process {} of user {}", who.pid, who.uid),
        Err(_) => "unknown process".into(),
    };
    let node = match options.connect(path, "doctor", interrupt) {
        Ok(node) => node,
        Err(error) => return Found::only(vec![unreachable(error, &who)]),
    };
    let epoch = node
        .epoch()
        .map_or_else(String::new, |epoch| format!(", epoch {epoch:x}"));
    let mut checks = vec![Check::ok(
        CHECK,
        format!("{who}, protocol version {}{epoch}", sm2_proto::VERSION),
    )];
    match node.snapshot() {
        Ok(mirror) => {
            let view = View::new(&mirror);
            let quotas = quotas(&view);
            let troubles = troubles(&node, &view, interrupt);
            checks.extend(domain(&view, &quotas, &troubles, &node));
            Found {
                checks,
                nodes: Some(mirror.nodes().count() as u64),
                limits: mirror.limits().cloned().map(LimitsInForce),
                quotas,
            }
        }
        Err(error) => {
            let advice = "is the Manager stopped, or overloaded? see its log";
            checks.push(Check::bad("domain", error.to_string(), advice));
            Found::only(checks)
        }
    }
}

/// The checks of the state of a domain. `node` is the node of this command.
pub(super) fn domain(
    view: &View<'_>,
    quotas: &[Quota],
    troubles: &LinkTroubles,
    node: &Node,
) -> [Check; 9] {
    let mirror = view.domain;
    [
        standby(mirror),
        resuming(mirror),
        stopped(mirror),
        consumers(troubles),
        losses(troubles),
        deadlines(troubles),
        connections::unlinked(view),
        usage(quotas),
        refused(mirror, node),
    ]
}

/// The troubles on all links. There are none if the counters cannot be read.
fn troubles(node: &Node, view: &View<'_>, interrupt: &Interrupt) -> LinkTroubles {
    let nodes = view.domain.nodes().map(|it| it.node).collect();
    let wait = |until| {
        let signal = [(interrupt.as_fd(), For::Reading)];
        while interrupt.signal().is_none() && clock::now() < until {
            drive(node, &signal, Some(until))?;
        }
        Ok(interrupt.signal().is_none())
    };
    let observed = Observation::make(node, view.domain, &nodes, wait);
    observed.map_or_else(
        |_| LinkTroubles::default(),
        |it| LinkTroubles::of_all(view, it.readings()),
    )
}

/// Subscribers and servers that take nothing although messages wait.
fn consumers(troubles: &LinkTroubles) -> Check {
    let ends = &troubles.not_taking;
    let advice = each_once(ends.iter().map(NotTaking::remedy)).join("; or ");
    Check::warn_of("consumers", "all take what waits for them", ends, advice)
}

/// Messages that are being lost on links whose receiving ends take others.
fn losses(troubles: &LinkTroubles) -> Check {
    let advice = each_once(troubles.losing().map(Losing::remedy)).join("; or ");
    let none = "no message is being lost";
    Check::warn_of("losses", none, troubles.losing(), advice)
}

/// Deadlines that are being missed.
fn deadlines(troubles: &LinkTroubles) -> Check {
    let missing = &troubles.missing_deadlines;
    let advice = see_why(missing.first().map(|it| it.interface.as_str()));
    Check::warn_of("deadlines", "none is being missed", missing, advice)
}

/// The advice to look at the first of some interfaces. A check without any does not show it.
fn see_why(first: Option<&str>) -> String {
    format!("see `sm2 why {}`", first.unwrap_or_default())
}

/// Texts in order, each once.
fn each_once<'a>(texts: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let texts: BTreeSet<_> = texts.collect();
    texts.into_iter().collect()
}

fn unreachable(error: CliError, who: &str) -> Check {
    const CHECK: &str = "Manager";
    match error {
        CliError::NoManager { path, option } => Check::bad(
            CHECK,
            format!("none answers at {}", path.display()),
            format!("start one with `sm2 manager{option}`"),
        ),
        CliError::Connect(error @ ConnectError::TimedOut { .. }) => Check::bad(
            CHECK,
            format!("{who} does not answer"),
            format!("{error} continue it (kill -CONT) or end it"),
        ),
        CliError::Connect(error) => Check::bad(
            CHECK,
            error.to_string(),
            "without a session nothing else of the domain can be checked",
        ),
        error => Check::bad(CHECK, error.to_string(), "without it no node can start"),
    }
}

fn standby(mirror: &Mirror) -> Check {
    const CHECK: &str = "standby";
    let all = mirror
        .nodes()
        .filter(|node| node.name.as_str().starts_with(STANDBY));
    let names: Vec<_> = all.map(|node| format!("process {}", node.pid)).collect();
    match names.is_empty() {
        false => Check::ok(CHECK, names.join(", ")),
        true => Check::warn(
            CHECK,
            "no Manager stands by",
            "start one with `sm2 manager --standby`, which continues to make links when this Manager ends",
        ),
    }
}

fn resuming(mirror: &Mirror) -> Check {
    let resuming = mirror.nodes().filter(|node| node.resuming);
    let advice = "a node may take some seconds to claim its links: run doctor again; \
                  a node that is still listed is stopped or busy";
    let names = resuming.map(|node| node.name);
    Check::warn_of("resuming nodes", "none", names, advice)
}

fn stopped(mirror: &Mirror) -> Check {
    let stopped = mirror.nodes().filter_map(|it| StoppedNode::find(&it));
    let stopped: Vec<_> = stopped.collect();
    let remedies: Vec<_> = stopped.iter().map(StoppedNode::remedy).collect();
    Check::warn_of("stopped nodes", "none", &stopped, remedies.join(", "))
}

/// The limits that are used to a great part, with the options that raise them.
fn usage(quotas: &[Quota]) -> Check {
    let near = || quotas.iter().filter(|it| it.is_near());
    let found = near().map(|it| format!("{}: {} of {} {}", it.of, it.used, it.limit, it.quota));
    let options = each_once(near().map(|it| it.kind.name())).join(", ");
    let advice = format!("close some, or raise {options} of `sm2 manager`");
    let none = format!("all below {NEAR_PERCENT} %");
    Check::warn_of("quotas", none, found, advice)
}

/// A program with a refused interface seems to run, and does not work.
fn refused(mirror: &Mirror, node: &Node) -> Check {
    let view = View::new(mirror);
    let all = mirror.interfaces().filter(|it| it.refused.is_some());
    let others = all.filter(|it| view.name_of(it.entity.node) != node.name().as_str());
    let titles: Vec<_> = others.map(|it| view.title(it.entity)).collect();
    let advice = see_why(titles.first().map(String::as_str));
    Check::warn_of("refused interfaces", "none", titles, advice)
}
