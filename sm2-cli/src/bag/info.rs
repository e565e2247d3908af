//! Shows the content of bags.

use std::path::PathBuf;

use clap::Args;
use sm2_bag::{Bag, BagFiles, Report};

use super::work::Work;
use crate::{bag_summary::print, ended::Ended, error::CliError};

/// `sm2 bag info`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The bag: a file, or a folder
    #[arg(value_name = "BAG")]
    file: PathBuf,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
A bag whose recorder was killed has no summary. Its messages are then counted, as far as they can be read, and
the output says that the bag is incomplete (JSON: `complete` is false) and names the parts that are damaged
(`damaged`). A bag with a summary is not read completely: `sm2 bag check` does that. If the index of a bag
of another program has the counts, its messages are not read: then `bytes` is null.

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
    let files = BagFiles::find(&arguments.file)?;
    let mut work = Work::begin([&files])?;
    let bags = files.open(&mut |it| work.advance(it));
    let bags = bags.map_err(|it| work.error(it))?;
    let reports: Vec<_> = bags.iter().map(Bag::report).collect();
    let report = Report::of_files(&reports);
    print(&arguments.file, &report, arguments.json)?;
    Ok(Ended::Done)
}
