use std::{fmt::Write as _, io::Write as _, time::Duration};

use clap::Args;
use sm2_node::params::Table;
use sm2_proto::Name;

use super::{row::Node, source};
use crate::{
    args::{Domain, name},
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    output::Output,
    time,
};

/// `sm2 param dump`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    /// The timeout for the values of the node
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    /// Print one JSON object in place of a file
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Prints TOML, which `sm2 param load` and programs read: `SM2_PARAMS=lidar.toml PROGRAM`. The descriptions are its
comments.

Exit status: 0 printed, 1 there is no such node, or it has no parameters, 2 wrong usage, 130 Ctrl-C.

Examples:
  sm2 param dump lidar
  sm2 param dump lidar > lidar.toml";

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.domain, "param-dump")?;
    let node = &arguments.node;
    let table = source::table(&command_node, node, arguments.timeout)?;
    Output::new().answer(arguments.json, &Node::new(node, &table), |out| {
        out.write(|out| out.write_all(file(node, &table).as_bytes()))
    })?;
    Ok(Ended::Done)
}

/// The parameters as a file. Control characters are escaped as TOML does it.
fn file(node: &Name, table: &Table) -> String {
    let mut text = match node.as_str().contains('/') {
        true => format!("[\"{node}\"]\n"),
        false => format!("[{node}]\n"),
    };
    for entry in &table.parameters {
        let description: String = (entry.description.chars())
            .map(|it| if it.is_control() { ' ' } else { it })
            .collect();
        if !description.is_empty() {
            let _ = writeln!(text, "# {description}");
        }
        if let Some(range) = entry.range {
            let _ = writeln!(text, "# {range}");
        }
        // `filter` and `filter.size` cannot both be keys of a table, unless the second one is quoted.
        let is_table = |it: &str| table.get(it).is_some();
        let dots = entry.name.match_indices('.');
        let is_inside = dots.map(|(at, _)| &entry.name[..at]).any(is_table);
        let _ = match is_inside {
            true => writeln!(text, "\"{}\" = {}", entry.name, entry.value),
            false => writeln!(text, "{} = {}", entry.name, entry.value),
        };
    }
    text
}
