use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sm2_io::clock;
use sm2_node::params::{Entry, Table};
use sm2_proto::Name;

use super::{
    error::ParamError,
    row::Node,
    source::{self, Source},
};
use crate::{
    args::name,
    columns::{self, Column},
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    output::Output,
    report::Options,
    time::{self, Span},
};

/// `sm2 param list`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node [default: all nodes that have parameters]
    #[arg(value_name = "NODE", value_parser = name)]
    node: Option<Name>,
    /// The timeout for the values of all nodes
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
FROM is the place of the value: the default of the program, a file, the environment, or a set.

Exit status: 0 printed, 1 a node has no parameters or has not answered, 2 wrong usage, 130 Ctrl-C.

Examples:
  sm2 param list
  sm2 param list lidar --json | jq '.nodes[].parameters[].name'";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Nodes<'a> {
    nodes: Vec<Node<'a>>,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.options.domain, "param-list")?;
    let until = clock::now().after(arguments.timeout);
    let sources = match &arguments.node {
        Some(node) => vec![Source::open(&command_node, node)?],
        None => {
            let nodes = source::nodes(&command_node.snapshot()?);
            let open = |node| Source::subscribe(&command_node, node);
            nodes.iter().map(open).collect::<Result<_, _>>()?
        }
    };
    let mut tables: Vec<(&Name, Table)> = Vec::new();
    let mut ended = Ended::Done;
    for source in &sources {
        match source.first(&command_node, until.since(clock::now())) {
            Ok(table) => tables.push((&source.node, table)),
            // The other nodes are shown all the same.
            Err(CliError::Param(ParamError::NoTable { node, .. })) => {
                let timeout = Span(arguments.timeout);
                stderr_line!("sm2: {}", ParamError::NoTable { node, timeout });
                ended = Ended::No;
            }
            Err(error) => return Err(error),
        }
    }
    let nodes = tables.iter().map(|(node, table)| Node::new(node, table));
    let nodes = nodes.collect();
    Output::new().answer(arguments.options.json, &Nodes { nodes }, |out| {
        let of_node = |(node, table): &(&Name, Table)| {
            let row = |it: &Entry| Row((*node).clone(), it.clone());
            table.parameters.iter().map(row).collect::<Vec<_>>()
        };
        let rows: Vec<_> = tables.iter().flat_map(of_node).collect();
        out.line(columns::Table(&rows))
    })?;
    Ok(ended)
}

/// The rows for people: a node, and one of its parameters.
struct Row(Name, Entry);

impl columns::Row for Row {
    const COLUMNS: &'static [Column<Self>] = &[
        ("NODE", |it| it.0.to_string()),
        ("NAME", |it| it.1.name.clone()),
        ("TYPE", |it| it.1.kind().to_string()),
        ("VALUE", |it| it.1.value.to_string()),
        ("FROM", |it| it.1.origin.word().to_owned()),
    ];
}
