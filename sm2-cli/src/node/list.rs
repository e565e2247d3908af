use std::collections::BTreeMap;

use clap::Args;
use serde::Serialize;
use sm2_proto::{Kind, Name, NodeId, domain::Domain as Mirror};

use crate::{
    args::Domain, columns::Columns, connect::Session, ended::Ended, error::CliError, output::Output,
};

/// `sm2 node list`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
LINKS counts the ends of links: a link between two interfaces of one node counts twice.

Examples:
  sm2 node list
  sm2 node list --json | jq '.nodes[] | select(.publishers > 0)'";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Nodes {
    /// The domain's revision.
    revision: u64,
    nodes: Vec<Node>,
}

/// A node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Node {
    id: u64,
    name: String,
    uid: u32,
    pid: i32,
    publishers: u64,
    subscribers: u64,
    servers: u64,
    clients: u64,
    links: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "node-list")?;
    let domain = session.snapshot()?;
    let nodes = Nodes {
        revision: domain.revision(),
        nodes: nodes(&domain, session.node.name()),
    };
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&nodes)?,
        false => out.line(table(&nodes.nodes))?,
    }
    Ok(Ended::Done)
}

/// The nodes in the order in which they connected, without the one named `itself`.
fn nodes(domain: &Mirror, itself: &Name) -> Vec<Node> {
    let others = domain.nodes().filter(|node| node.name != itself);
    let mut nodes: BTreeMap<NodeId, Node> = others
        .map(|it| {
            let node = Node {
                id: it.node.0,
                name: it.name.to_string(),
                uid: it.uid,
                pid: it.pid,
                publishers: 0,
                subscribers: 0,
                servers: 0,
                clients: 0,
                links: 0,
            };
            (it.node, node)
        })
        .collect();
    for it in domain.interfaces().filter(|it| it.refused.is_none()) {
        if let Some(node) = nodes.get_mut(&it.entity.node) {
            *node.count_of(it.contract.kind()) += 1;
        }
    }
    for link in domain.links() {
        for entity in [link.offering, link.demanding] {
            if let Some(node) = nodes.get_mut(&entity.node) {
                node.links += 1;
            }
        }
    }
    nodes.into_values().collect()
}

impl Node {
    const fn count_of(&mut self, kind: Kind) -> &mut u64 {
        match kind {
            Kind::Publisher => &mut self.publishers,
            Kind::Subscriber => &mut self.subscribers,
            Kind::Server => &mut self.servers,
            Kind::Client => &mut self.clients,
        }
    }
}

fn table(nodes: &[Node]) -> Columns<9> {
    let mut table = Columns::new([
        "NODE",
        "ID",
        "UID",
        "PID",
        "PUBLISHERS",
        "SUBSCRIBERS",
        "SERVERS",
        "CLIENTS",
        "LINKS",
    ]);
    for node in nodes {
        table.push([
            node.name.clone(),
            node.id.to_string(),
            node.uid.to_string(),
            node.pid.to_string(),
            node.publishers.to_string(),
            node.subscribers.to_string(),
            node.servers.to_string(),
            node.clients.to_string(),
            node.links.to_string(),
        ]);
    }
    table
}
