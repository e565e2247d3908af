use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sm2_node::params::{Assignment, Table};
use sm2_proto::Name;

use super::{
    error::ParamError,
    source::{self, entry},
};
use crate::{
    args::name, connect::CommandNode, ended::Ended, error::CliError, output::Output,
    report::Options, time,
};

/// `sm2 param set`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The node
    #[arg(value_name = "NODE", value_parser = name)]
    node: Name,
    /// A parameter and its new value, such as `max_range 12.5`; may be repeated
    #[arg(value_names = ["NAME", "VALUE"], num_args = 2.., required = true, allow_negative_numbers = true)]
    values: Vec<String>,
    /// The timeout for the values of the node, and for its answer
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span)]
    timeout: Duration,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
A string is written as it is, and all other values as in TOML: 12.5, true, '[1, 2]', '[\"a\", \"b\"]'. The node
gets all values in one request, and sets all of them or none. It refuses values outside of the ranges, and
its program may refuse others.

Exit status: 0 set, 1 refused, or the node has not answered, 2 wrong usage, 130 Ctrl-C.

Examples:
  sm2 param set lidar max_range 12.5
  sm2 param set lidar min_range 0.5 max_range 20 --json";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Done<'a> {
    node: &'a str,
    /// The number of parameters in the request.
    parameters: usize,
    /// The revision of the node's parameters after it.
    revision: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let Arguments { node, timeout, .. } = arguments;
    let (values, rest) = arguments.values.as_chunks::<2>();
    if let [name] = rest {
        let name = name.clone();
        return Err(ParamError::NoValue { name }.into());
    }
    let command_node = CommandNode::open(&arguments.options.domain, "param-set")?;
    let request = |table: &Table| {
        values
            .iter()
            .map(|it| assignment(it, node, table))
            .collect()
    };
    apply(
        &command_node,
        node,
        *timeout,
        arguments.options.json,
        request,
    )
}

fn assignment(
    [name, text]: &[String; 2],
    node: &Name,
    table: &Table,
) -> Result<Assignment, ParamError> {
    let kind = entry(table, node, name)?.kind();
    let name = name.clone();
    match kind.parse(text) {
        Ok(value) => Ok(Assignment { name, value }),
        Err(reason) => Err(ParamError::Value { name, reason }),
    }
}

/// Sets the parameters that `request` makes of the node's present ones, and prints the object for `--json`. Nothing is
/// sent if there are none.
///
/// # Errors
///
/// Those of `request`, [`source::table`] and [`source::set`].
pub(super) fn apply(
    command_node: &CommandNode,
    node: &Name,
    timeout: Duration,
    json: bool,
    request: impl FnOnce(&Table) -> Result<Vec<Assignment>, ParamError>,
) -> Result<Ended, CliError> {
    let table = source::table(command_node, node, timeout)?;
    let assignments = request(&table)?;
    let parameters = assignments.len();
    let revision = match parameters {
        0 => table.revision,
        _ => source::set(command_node, node, assignments, timeout)?,
    };
    if json {
        Output::new().json(&Done {
            node: node.as_str(),
            parameters,
            revision,
        })?;
    }
    Ok(Ended::Done)
}
