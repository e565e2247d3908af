//! Who answers at the socket, and what the domain says of itself.

use std::path::Path;

use sm2_io::SeqPacket;
use sm2_node::{ConnectError, Node};
use sm2_proto::domain::Domain as Mirror;

use super::check::Check;
use crate::{
    args::Domain, error::CliError, interrupt::Interrupt, snapshot::document::quotas,
    stopped::StoppedNode, view::View,
};

/// How nodes of standby Managers are named.
const STANDBY: &str = "sm2/standby/";

/// A quota of which more than so much is used will be a problem soon.
const NEARLY_PERCENT: u64 = 80;

/// The checks, and how many nodes the domain has, if that is known.
pub(super) fn checks(
    domain: &Domain,
    path: &Path,
    interrupt: &Interrupt,
) -> (Vec<Check>, Option<u64>) {
    const CHECK: &str = "Manager";
    // Before the session: who it is can be told even of one that does not answer.
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

/// What the domain says.
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
            "start one with `sm2 manager --standby`, so that new links go on being made when this one ends",
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
            "they have seconds to claim their links: look again; whoever stays is stopped or busy",
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
            "close some, or raise them (`sm2 manager --max-sessions`, `--max-interfaces`, `--max-links`)",
        ),
    }
}

/// Interfaces that were refused are why programs do not work that seem to run.
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
