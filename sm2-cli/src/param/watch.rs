use std::collections::HashMap;

use clap::Args;
use sm2_node::params::{Entry, Table, Value};
use sm2_proto::Name;

use super::{
    row::Node,
    source::{Source, entry},
};
use crate::{
    args::{Domain, name},
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    output::Output,
};

/// `sm2 param watch`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    /// The parameters [default: all of the node]
    #[arg(value_name = "NAME")]
    names: Vec<String>,
    /// End after this number of changes
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Print one JSON object for each change
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Prints the present values, and then each change, with the revision of the node's parameters. When the node is
gone, the command waits until it is there again.

Exit status: 0 ended by Ctrl-C or --count, 1 there is no such node or parameter, 2 wrong usage.

Examples:
  sm2 param watch lidar
  sm2 param watch lidar max_range --json";

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.domain, "param-watch")?;
    let source = Source::open(&command_node, &arguments.node)?;
    let mut out = Output::new();
    let mut known: HashMap<String, (Value, u64)> = HashMap::new();
    let mut changes = 0;
    let mut is_first = true;
    while let Some(table) = source.next(&command_node, None)? {
        if is_first {
            for name in &arguments.names {
                entry(&table, &arguments.node, name)?;
            }
        }
        let changed = changed(&table, &arguments.names, &mut known);
        if changed.is_empty() {
            continue;
        }
        print(&mut out, arguments, &table, &changed)?;
        changes += u64::from(!is_first);
        is_first = false;
        if arguments.count.is_some_and(|it| changes >= it) {
            break;
        }
    }
    Ok(Ended::Done)
}

/// The parameters of these names, or all of them, that differ from those before.
fn changed<'a>(
    table: &'a Table,
    names: &[String],
    known: &mut HashMap<String, (Value, u64)>,
) -> Vec<&'a Entry> {
    let wanted = |it: &&Entry| names.is_empty() || names.contains(&it.name);
    let entries = table.parameters.iter().filter(wanted);
    let changed = entries.filter(|it| {
        let now = (it.value.clone(), it.revision);
        let before = known.insert(it.name.clone(), now.clone());
        before.is_none_or(|before| before != now)
    });
    changed.collect()
}

fn print(
    out: &mut Output,
    arguments: &Arguments,
    table: &Table,
    changed: &[&Entry],
) -> Result<(), CliError> {
    if arguments.json {
        out.json(&Node::with(&arguments.node, table, changed.iter().copied()))?;
    } else {
        for entry in changed {
            let (revision, name, value) = (table.revision, &entry.name, &entry.value);
            out.line(format_args!("{revision}: {name} = {value}"))?;
        }
    }
    out.flush()
}
