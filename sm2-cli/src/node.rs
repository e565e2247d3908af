//! `sm2 node`: list nodes.

use clap::{Args, Subcommand};
use serde::Serialize;

use crate::{
    Ended,
    args::Domain,
    columns::Columns,
    connect::Session,
    domain::{self, Node},
    error::CliError,
    output::Output,
};

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// List the nodes of a domain
    List(ListArguments),
}

/// `sm2 node list`.
#[derive(Args, Debug)]
#[command(after_help = LIST_HELP)]
pub(crate) struct ListArguments {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const LIST_HELP: &str = "\
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

/// Runs a command.
///
/// # Errors
///
/// What it failed with.
pub(crate) fn run(Command::List(arguments): &Command) -> Result<Ended, CliError> {
    let session = Session::open(&arguments.domain, "node-list")?;
    let graph = session.graph()?;
    let nodes = Nodes {
        revision: graph.revision,
        nodes: domain::nodes(&graph.items, session.node.name()),
    };
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&nodes)?,
        false => out.line(table(&nodes.nodes))?,
    }
    out.flush()?;
    Ok(Ended::Done)
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
