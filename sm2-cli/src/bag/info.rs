//! `sm2 bag info`.

use std::path::PathBuf;

use clap::Args;
use sm2_bag::Bag;

use super::work::Work;
use crate::{bag_summary::show, ended::Ended, error::CliError, output::Output};

/// `sm2 bag info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The bag
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
A bag whose recorder was killed has no summary. Its messages are then counted, as far as they can be read, and
the output says that the bag is incomplete (JSON: `complete` is false) and names the parts that are damaged
(`damaged`). A bag with a summary is not read completely: `sm2 bag check` does that.

Times are those of the wall clock at the start of the recording. JSON has them in nanoseconds since 1970.

Exit status: 0 this is a bag, 1 it cannot be read, 2 wrong usage.

Examples:
  sm2 bag info drive.mcap
  sm2 bag info drive.mcap --json | jq '.topics[].messages'";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let mut work = Work::begin([arguments.file.as_path()])?;
    let bag = Bag::open_observed(&arguments.file, &mut |it| work.note(it));
    let bag = bag.map_err(|it| work.error(it))?;
    let mut out = Output::new();
    match arguments.json {
        true => out.json(&bag.report())?,
        false => show(&mut out, bag.path(), &bag.report())?,
    }
    out.flush()?;
    Ok(Ended::Done)
}
