//! Shows one node with its interfaces.

use clap::Args;
use serde::Serialize;
use sm2_proto::{Name, domain::NodeView};

use crate::{
    args::name,
    columns::Table,
    ended::Ended,
    error::CliError,
    interfaces::InterfaceReport,
    names,
    report::{Options, Report, facts},
    view::View,
};

/// `sm2 node info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
Exit status: 0 shown, 1 there is no such node, 2 wrong usage.

Examples:
  sm2 node info talker
  sm2 node info talker --json | jq -r '.interfaces[].name'";

#[derive(Serialize)]
struct Info {
    id: u64,
    name: String,
    uid: u32,
    pid: i32,
    /// Whether the node is still claiming the links that an earlier Manager made.
    resuming: bool,
    /// Includes the interfaces that the Manager refused.
    interfaces: Vec<InterfaceReport>,
    /// The names of the nodes at the other ends of its links.
    linked_with: Vec<String>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    arguments.options.print("node-info", |_, view| {
        let node = view.domain.node_named(arguments.node.as_str());
        node.map(|node| info(view, node)).ok_or_else(|| {
            let known = view.domain.nodes().map(|node| node.name);
            names::unknown("node", &arguments.node, known)
        })
    })
}

fn info(view: &View<'_>, node: NodeView<'_>) -> Info {
    let own = || view.domain.interfaces_of(node.node);
    let peers = own().flat_map(|it| view.links_of(it.entity)).map(|link| {
        match link.offering.node == node.node {
            true => link.demanding.node,
            false => link.offering.node,
        }
    });
    let mut linked_with: Vec<_> = peers.map(|it| view.name_of(it).to_owned()).collect();
    linked_with.sort_unstable();
    linked_with.dedup();
    Info {
        id: node.node.0,
        name: node.name.to_string(),
        uid: node.uid,
        pid: node.pid,
        resuming: node.resuming,
        interfaces: own().map(|it| InterfaceReport::new(view, it)).collect(),
        linked_with,
    }
}

impl Report for Info {
    fn text(&self) -> String {
        let peers = match self.linked_with.as_slice() {
            [] => "nobody".to_owned(),
            peers => peers.join(", "),
        };
        let facts = facts(&[
            ("node", &self.name),
            ("id", &self.id.to_string()),
            ("process", &format!("{} of user {}", self.pid, self.uid)),
            ("state", if self.resuming { "resuming" } else { "ready" }),
            ("linked with", &peers),
        ]);
        let facts = facts.join("\n");
        match self.interfaces.as_slice() {
            [] => facts,
            interfaces => format!("{facts}\n\n{}", Table(interfaces)),
        }
    }
}
