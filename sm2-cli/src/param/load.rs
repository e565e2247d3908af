use std::{path::PathBuf, time::Duration};

use clap::Args;
use sm2_node::params::{ALL_NODES, Assignment, File, FileValue, Table};
use sm2_proto::Name;

use super::{error::ParamError, set, source::entry};
use crate::{
    args::name, connect::CommandNode, ended::Ended, error::CliError, report::Options, time,
};

/// `sm2 param load`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    /// A file of parameters, such as `sm2 param dump` prints
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The timeout for the values of the node, and for its answer
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
The file has a table for each node; the table \"*\" is for all nodes that have such parameters. The node gets all
values that differ from its own in one request, and sets all of them or none.

Exit status: 0 set, 1 refused, or the node has not answered, 2 wrong usage, 130 Ctrl-C.

Examples:
  sm2 param load lidar lidar.toml
  sm2 param load lidar lidar.toml --json";

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let Arguments { node, timeout, .. } = arguments;
    let file = File::load(&arguments.file).map_err(ParamError::File)?;
    let command_node = CommandNode::open(&arguments.options.domain, "param-load")?;
    let request = |table: &Table| assignments(&file, node, table);
    set::apply(
        &command_node,
        node,
        *timeout,
        arguments.options.json,
        request,
    )
}

/// The values of the file that differ from those of the node.
fn assignments(file: &File, node: &Name, table: &Table) -> Result<Vec<Assignment>, ParamError> {
    let known = |it: &&FileValue| table.get(&it.name).is_some();
    let own: Vec<_> = file.values(node.as_str()).collect();
    let common: Vec<_> = file.values(ALL_NODES).filter(known).collect();
    if own.is_empty() && common.is_empty() {
        let path = file.path().to_owned();
        let node = node.clone();
        return Err(ParamError::NotInFile { path, node });
    }
    let is_own = |it: &&FileValue| own.iter().any(|own| own.name == it.name);
    let common = common.into_iter().filter(|it| !is_own(it));
    let mut assignments = Vec::new();
    for given in common.chain(own.iter().copied()) {
        let in_file = |source| ParamError::InFile {
            path: file.path().to_owned(),
            line: given.line,
            source: Box::new(source),
        };
        let entry = entry(table, node, &given.name).map_err(in_file)?;
        let value = given.read(entry.kind()).map_err(|reason| {
            let name = given.name.clone();
            in_file(ParamError::Value { name, reason })
        })?;
        if entry.value != value {
            let name = given.name.clone();
            assignments.push(Assignment { name, value });
        }
    }
    Ok(assignments)
}
