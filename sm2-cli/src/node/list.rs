//! `sm2 node list`.

use serde::Serialize;
use sm2_proto::{Kind, domain::NodeView};

use crate::{
    columns::{Column, Row},
    ended::Ended,
    error::CliError,
    report::{List, Options},
    view::{View, count},
};

pub(super) const HELP: &str = "\
LINKS counts the ends of links: a link between two interfaces of one node counts twice.

Examples:
  sm2 node list
  sm2 node list --json | jq '.nodes[] | select(.publishers > 0)'";

#[derive(Serialize)]
struct Node {
    id: u64,
    name: String,
    uid: u32,
    pid: i32,
    publishers: usize,
    subscribers: usize,
    servers: usize,
    clients: usize,
    links: usize,
}

impl Row for Node {
    const COLUMNS: &'static [Column<Self>] = &[
        ("NODE", |it| it.name.clone()),
        ("ID", |it| it.id.to_string()),
        ("UID", |it| it.uid.to_string()),
        ("PID", |it| it.pid.to_string()),
        ("PUBLISHERS", |it| it.publishers.to_string()),
        ("SUBSCRIBERS", |it| it.subscribers.to_string()),
        ("SERVERS", |it| it.servers.to_string()),
        ("CLIENTS", |it| it.clients.to_string()),
        ("LINKS", |it| it.links.to_string()),
    ];
}

/// Lists the nodes in the order in which they connected, without that of the command.
pub(super) fn run(options: &Options) -> Result<Ended, CliError> {
    options.print("node-list", |command_node, view| {
        let nodes = view.domain.nodes();
        let others = nodes.filter(|it| it.name != command_node.node.name());
        let (name, rows) = ("nodes", others.map(|it| node(view, it)).collect());
        Ok(List { name, rows })
    })
}

fn node(view: &View<'_>, node: NodeView<'_>) -> Node {
    let own = || view.domain.interfaces_of(node.node);
    let granted: Vec<_> = own().filter(|it| it.refused.is_none()).collect();
    Node {
        id: node.node.0,
        name: node.name.to_string(),
        uid: node.uid,
        pid: node.pid,
        publishers: count(&granted, Kind::Publisher),
        subscribers: count(&granted, Kind::Subscriber),
        servers: count(&granted, Kind::Server),
        clients: count(&granted, Kind::Client),
        links: own().map(|it| view.links_of(it.entity).len()).sum(),
    }
}
