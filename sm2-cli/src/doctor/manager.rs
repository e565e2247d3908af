//! Checks of the Manager at the socket, and of the state of its domain.

use std::path::Path;

use sm2_io::SeqPacket;
use sm2_node::{ConnectError, Node};
use sm2_proto::domain::Domain as Mirror;

use super::check::Check;
use crate::{
    args::Domain, error::CliError, interrupt::Interrupt, snapshot::document::quotas,
    stopped::StoppedNode, view::View,
};

/// The start of the node names of standby Managers.
const STANDBY: &str = "sm2/standby/";

/// A quota is reported when more than this share of it is used.
const NEARLY_PERCENT: u64 = 80;

/// The checks, and the number of nodes in the domain if it is known.
pub(super) fn checks(
    domain: &Domain,
    path: &Path,
    interrupt: &Interrupt,
) -> (Vec<Check>, Option<u64>) {
    const CHECK: &str = "Manager";
    // Before the session starts: the kernel names the process even if it does not answer.
    let who = SeqPacket::connect(path).and_then(|socket| socket.peer_credentials());
    let who = match who {
        Ok(who) => format!("process {} of user {}", who.pid, who.uid),
        Err(_) => "unknown process".into(),
    };
    let node = match domain.connect(path, "doctor", interrupt) {
        Ok(node) => node,
        Err(error) => return (vec![unreachable(error, &who)], None),
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
            checks.extend(inside(&mirror, &node));
            let nodes = mirror.nodes().count() as u64;
            (checks, Some(nodes))
        }
        Err(error) => {
            let advice = "is the Manager stopped, or overloaded? see its log";
            checks.push(Check::bad("domain", error.to_string(), advice));
            (checks, None)
        }
    }
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

/// The checks of the state of the domain.
pub(super) fn inside(mirror: &Mirror, node: &Node) -> Vec<Check> {
    let mut checks = vec![standby(mirror), resuming(mirror), stopped(mirror)];
    checks.push(usage(mirror));
    checks.push(refused(mirror, node));
    checks
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
    const CHECK: &str = "resuming nodes";
    let all = mirror.nodes().filter(|node| node.resuming);
    let names: Vec<_> = all.map(|node| node.name.to_string()).collect();
    match names.is_empty() {
        true => Check::ok(CHECK, "none"),
        false => Check::warn(
            CHECK,
            names.join(", "),
            "a node may take some seconds to claim its links: run doctor again; \
             a node that is still listed is stopped or busy",
        ),
    }
}

fn stopped(mirror: &Mirror) -> Check {
    const CHECK: &str = "stopped nodes";
    let all: Vec<_> = mirror
        .nodes()
        .filter_map(|it| StoppedNode::find(&it))
        .collect();
    let found: Vec<_> = all.iter().map(ToString::to_string).collect();
    let remedies: Vec<_> = all.iter().map(StoppedNode::remedy).collect();
    match all.is_empty() {
        true => Check::ok(CHECK, "none"),
        false => Check::warn(CHECK, found.join(", "), remedies.join(", ")),
    }
}

fn usage(mirror: &Mirror) -> Check {
    const CHECK: &str = "quotas";
    let quotas = quotas(&View::new(mirror));
    let nearly = quotas
        .iter()
        .filter(|quota| u64::from(quota.used) * 100 > u64::from(quota.limit) * NEARLY_PERCENT);
    let found: Vec<_> = nearly
        .map(|it| format!("{}: {} of {} {}", it.of, it.used, it.limit, it.quota))
        .collect();
    match found.is_empty() {
        true => Check::ok(CHECK, format!("all below {NEARLY_PERCENT} %")),
        false => Check::warn(
            CHECK,
            found.join(", "),
            "close some, or raise them (`sm2 manager --max-sessions`, `--max-interfaces`, `--max-links`, …)",
        ),
    }
}

/// A program with a refused interface seems to run, and does not work.
fn refused(mirror: &Mirror, node: &Node) -> Check {
    const CHECK: &str = "refused interfaces";
    let view = View::new(mirror);
    let all = mirror.interfaces().filter(|it| it.refused.is_some());
    let others = all.filter(|it| view.name_of(it.entity.node) != node.name().as_str());
    let titles: Vec<_> = others.map(|it| view.title(it.entity)).collect();
    match &*titles {
        [] => Check::ok(CHECK, "none"),
        [first, ..] => Check::warn(CHECK, titles.join(", "), format!("see `sm2 why {first}`")),
    }
}
