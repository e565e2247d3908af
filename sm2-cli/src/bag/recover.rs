//! Makes a complete bag of one that was cut off.

use std::path::PathBuf;

use clap::Args;
use sm2_bag::BagFiles;

use super::work::Work;
use crate::{
    bag_summary::{ended, print},
    ended::Ended,
    error::CliError,
};

/// `sm2 bag recover`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The damaged bag, a file or a folder, which is not changed
    #[arg(value_name = "BAG")]
    file: PathBuf,
    /// The new bag [default: BAG with the ending .recovered.mcap]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print the summary of the new bag as one line of JSON
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
The new bag has everything that can be read, and a summary. Damaged parts are left out: they are named, and
their messages are gaps if the damaged bag has a summary. The unfinished end of a file whose recorder was killed
does not count as damage. An existing file is never overwritten.

Exit status: 0 the new bag is written, 1 failed or parts are damaged, 2 wrong usage.

Examples:
  sm2 bag recover drive.mcap
  sm2 bag recover drive.mcap -o whole.mcap";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::CopyBag`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let default = || arguments.file.with_extension("recovered.mcap");
    let path = arguments.output.clone().unwrap_or_else(default);
    let files = BagFiles::find(&arguments.file)?;
    // The readable part is read twice.
    let mut work = Work::begin([&files; 2])?;
    let report = sm2_bag::recover_observed(&arguments.file, &path, &mut |it| work.advance(it));
    let report = report.map_err(|it| work.error(it))?;
    print(&path, &report, arguments.json)?;
    Ok(ended(&report))
}
