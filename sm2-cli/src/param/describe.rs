use std::time::Duration;

use clap::Args;
use sm2_node::params::Entry;
use sm2_proto::Name;

use super::{
    row::Node,
    source::{self, entry},
};
use crate::{
    args::name, connect::CommandNode, ended::Ended, error::CliError, output::Output,
    report::Options, time,
};

/// `sm2 param describe`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    /// The parameters [default: all of the node]
    #[arg(value_name = "NAME")]
    names: Vec<String>,
    /// The timeout for the values of the node
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
Exit status: 0 printed, 1 there is no such node or parameter, 2 wrong usage, 130 Ctrl-C.

Examples:
  sm2 param describe lidar
  sm2 param describe lidar max_range --json";

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.options.domain, "param-describe")?;
    let node = &arguments.node;
    let table = source::table(&command_node, node, arguments.timeout)?;
    let entries: Vec<&Entry> = match arguments.names.as_slice() {
        [] => table.parameters.iter().collect(),
        names => {
            let entries = names.iter().map(|it| entry(&table, node, it));
            entries.collect::<Result<_, _>>()?
        }
    };
    let answer = Node::with(node, &table, entries.iter().copied());
    Output::new().answer(arguments.options.json, &answer, |out| {
        entries.iter().try_for_each(|it| describe(out, it))
    })?;
    Ok(Ended::Done)
}

fn describe(out: &mut Output, entry: &Entry) -> Result<(), CliError> {
    out.line(&entry.name)?;
    out.line(format_args!("  type         {}", entry.kind()))?;
    let (value, origin) = (&entry.value, entry.origin.word());
    out.line(format_args!("  value        {value} ({origin})"))?;
    if let Some(range) = entry.range {
        out.line(format_args!("  range        {range}"))?;
    }
    if entry.read_only {
        out.line("  read-only    set it in a file or the environment")?;
    }
    if !entry.description.is_empty() {
        out.line(format_args!("  description  {}", entry.description))?;
    }
    Ok(())
}
