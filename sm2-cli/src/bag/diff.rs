//! Compares the messages of two bags.

use std::path::PathBuf;

use clap::Args;
use sm2_bag::{BagFiles, Comparison};

use super::work::Work;
use crate::{ended::Ended, error::CliError, output::Output};

/// `sm2 bag diff`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The first bag: a file, or a folder
    #[arg(value_name = "FIRST")]
    first: PathBuf,
    /// The second bag: a file, or a folder
    #[arg(value_name = "SECOND")]
    second: PathBuf,
    /// Print one line of JSON: null if the payloads are the same
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
Compares the payloads of each topic, in the order of their times. Times, publishers and gaps may differ.
Messages and bytes are counted from 0. Damaged parts are told on standard error, and left out.

Exit status: 0 the payloads are the same, 1 they differ, a part is damaged or a bag cannot be read, 2 wrong
usage.

Examples:
  sm2 bag diff drive.mcap drive.mcap";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let [first, second] = [&arguments.first, &arguments.second].map(|it| BagFiles::find(it));
    let files = [first?, second?];
    let mut work = Work::begin(&files)?;
    let mut open = |files| work.open(files, "comparing");
    let [first, second] = [open(&files[0])?, open(&files[1])?];
    let difference = sm2_bag::diff_observed([&first, &second], &mut |it| work.advance(it));
    let Comparison {
        difference,
        damaged,
    } = difference.map_err(|it| work.error(it))?;
    let paths = [&arguments.first, &arguments.second];
    for (path, parts) in paths.iter().zip(&damaged) {
        for part in parts {
            stderr_line!(
                "sm2: {} is damaged, and compared without {part}",
                path.display()
            );
        }
    }
    Output::new().answer(arguments.json, &difference, |out| match &difference {
        Some(difference) => out.line(difference),
        None => out.line("the payloads are the same"),
    })?;
    let is_whole = damaged.iter().all(Vec::is_empty);
    Ok(Ended::with_answer(difference.is_none() && is_whole))
}
