use clap::Args;
use serde::Serialize;
use sm2_proto::{Name, domain::NodeView};

use crate::{
    args::{Domain, name},
    connect::Session,
    ended::Ended,
    error::CliError,
    interfaces::{Interface, table},
    names,
    output::Output,
    view::View,
};

/// `sm2 node info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Exit status: 0 shown, 1 there is no such node, 2 wrong usage.

Examples:
  sm2 node info talker
  sm2 node info talker --json | jq -r '.interfaces[].name'";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Info {
    /// The domain's revision.
    revision: u64,
    id: u64,
    name: String,
    uid: u32,
    pid: i32,
    /// Whether the node is still claiming the links that an earlier Manager made.
    resuming: bool,
    /// Includes the interfaces that the Manager refused.
    interfaces: Vec<Interface>,
    /// The names of the nodes at the other ends of its links.
    linked_with: Vec<String>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "node-info")?;
    let domain = session.snapshot()?;
    let view = View::new(&domain);
    let Some(node) = domain.node_named(arguments.node.as_str()) else {
        let known = domain.nodes().map(|node| node.name);
        return Err(names::unknown("node", &arguments.node, known));
    };
    let info = info(&view, node);
    let mut out = Output::new();
    if arguments.json {
        out.json(&info)?;
    } else {
        out.line(format_args!("node         {}", info.name))?;
        out.line(format_args!("id           {}", info.id))?;
        out.line(format_args!(
            "process      {} of user {}",
            info.pid, info.uid
        ))?;
        let state = if info.resuming { "resuming" } else { "ready" };
        out.line(format_args!("state        {state}"))?;
        let peers = match info.linked_with.as_slice() {
            [] => "nobody".to_owned(),
            peers => peers.join(", "),
        };
        out.line(format_args!("linked with  {peers}"))?;
        if !info.interfaces.is_empty() {
            out.line("")?;
            out.line(table(&info.interfaces))?;
        }
    }
    Ok(Ended::Done)
}

fn info(view: &View<'_>, node: NodeView<'_>) -> Info {
    let own = view.domain.interfaces_of(node.node);
    let mut linked_with: Vec<_> = own
        .flat_map(|it| view.links_of(it.entity))
        .map(|link| match link.offering.node == node.node {
            true => link.demanding.node,
            false => link.offering.node,
        })
        .map(|peer| view.name_of(peer).to_owned())
        .collect();
    linked_with.sort_unstable();
    linked_with.dedup();
    let own = view.domain.interfaces_of(node.node);
    Info {
        revision: view.domain.revision(),
        id: node.node.0,
        name: node.name.to_string(),
        uid: node.uid,
        pid: node.pid,
        resuming: node.resuming,
        interfaces: own.map(|it| Interface::new(view, it)).collect(),
        linked_with,
    }
}
