use std::time::Duration;

use clap::Args;
use sm2_proto::Name;

use super::{
    row::{Row, bare},
    source::{self, entry},
};
use crate::{
    args::name, connect::CommandNode, ended::Ended, error::CliError, output::Output,
    report::Options, time,
};

/// `sm2 param get`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    /// The parameter
    #[arg(value_name = "NAME")]
    name: String,
    /// The timeout for the values of the node
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
Prints a string as it is, and all other values as in TOML: 12.5, true, [1, 2]. The program of the node need not
do anything for that.

Exit status: 0 printed, 1 there is no such node or parameter, 2 wrong usage, 130 Ctrl-C.

Examples:
  sm2 param get lidar max_range
  sm2 param get lidar frame --json";

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.options.domain, "param-get")?;
    let table = source::table(&command_node, &arguments.node, arguments.timeout)?;
    let entry = entry(&table, &arguments.node, &arguments.name)?;
    Output::new().answer(arguments.options.json, &Row::from(entry), |out| {
        out.line(bare(&entry.value))
    })?;
    Ok(Ended::Done)
}
