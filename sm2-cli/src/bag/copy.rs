//! `sm2 bag filter`, `convert` and `merge`: copies of bags.

use std::{iter, path::PathBuf, slice};

use clap::Args;
use sm2_bag::{BagFiles, Filter};

use super::work::Work;
use crate::{
    bag_choice::Choice,
    bag_summary::{ended, print},
    compression::Compression,
    ended::Ended,
    error::CliError,
};

/// `sm2 bag filter`.
#[derive(Args, Debug)]
#[command(after_help = FILTER_HELP)]
pub(crate) struct FilterArguments {
    /// The bag, a file or a folder, which is not changed
    #[arg(value_name = "BAG")]
    file: PathBuf,
    #[command(flatten)]
    choice: Choice,
    /// How the new bag is compressed
    #[arg(long, value_enum, default_value_t = Compression::None)]
    compression: Compression,
    #[command(flatten)]
    target: Target,
}

/// `sm2 bag convert`.
#[derive(Args, Debug)]
#[command(after_help = CONVERT_HELP)]
pub(crate) struct ConvertArguments {
    /// The bag, a file or a folder, which is not changed
    #[arg(value_name = "BAG")]
    file: PathBuf,
    /// How the new bag is compressed
    #[arg(long, value_enum)]
    compression: Compression,
    #[command(flatten)]
    target: Target,
}

/// `sm2 bag merge`.
#[derive(Args, Debug)]
#[command(after_help = MERGE_HELP)]
pub(crate) struct MergeArguments {
    /// The bags, files or folders, which are not changed
    #[arg(value_name = "BAG", required = true, num_args = 2..)]
    files: Vec<PathBuf>,
    /// How the new bag is compressed
    #[arg(long, value_enum, default_value_t = Compression::None)]
    compression: Compression,
    #[command(flatten)]
    target: Target,
}

/// The new bag.
#[derive(Args, Debug)]
struct Target {
    /// The new bag
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Print the summary of the new bag as one line of JSON
    #[arg(long)]
    json: bool,
}

const FILTER_HELP: &str = "\
The new bag has the chosen messages with their times, and the gaps of their topics and times. An existing
file is never overwritten. Attachments are copied. Damaged parts are left out: they are named, and their
messages are gaps if the bag has a summary and no times are chosen.

Exit status: 0 the new bag is written, 1 failed or parts are damaged, 2 wrong usage.

Examples:
  sm2 bag filter drive.mcap --topic chatter -o chatter.mcap
  sm2 bag filter drive.mcap --start 100ms --end 300ms --compression zstd -o part.mcap --json";

const CONVERT_HELP: &str = "\
The new bag has all messages, gaps and times of the old one. An existing file is never overwritten.
Attachments are copied. Damaged parts are left out: they are named, and their messages are gaps if the bag
has a summary.

Exit status: 0 the new bag is written, 1 failed or parts are damaged, 2 wrong usage.

Examples:
  sm2 bag convert drive.mcap --compression zstd -o small.mcap";

const MERGE_HELP: &str = "\
The new bag has the messages of all bags in the order of their times. A publisher that is in several bags
with the same type and QoS is one channel of the new bag. An existing file is never overwritten.
Attachments are copied. Damaged parts are left out: they are named, and their messages are gaps if their bag
has a summary.

Exit status: 0 the new bag is written, 1 failed or parts are damaged, 2 wrong usage.

Examples:
  sm2 bag merge drive.mcap drive.mcap -o twice.mcap";

/// Runs `sm2 bag filter`.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::CopyBag`], [`CliError::Output`].
pub(super) fn filter(arguments: &FilterArguments) -> Result<Ended, CliError> {
    let (file, choice) = (slice::from_ref(&arguments.file), Some(&arguments.choice));
    copy(file, choice, arguments.compression, &arguments.target)
}

/// Runs `sm2 bag convert`.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::CopyBag`], [`CliError::Output`].
pub(super) fn convert(arguments: &ConvertArguments) -> Result<Ended, CliError> {
    let file = slice::from_ref(&arguments.file);
    copy(file, None, arguments.compression, &arguments.target)
}

/// Runs `sm2 bag merge`.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::CopyBag`], [`CliError::Output`].
pub(super) fn merge(arguments: &MergeArguments) -> Result<Ended, CliError> {
    copy(
        &arguments.files,
        None,
        arguments.compression,
        &arguments.target,
    )
}

/// Copies the messages of bags, or only those of a choice.
fn copy(
    paths: &[PathBuf],
    choice: Option<&Choice>,
    compression: Compression,
    target: &Target,
) -> Result<Ended, CliError> {
    let files = paths.iter().map(|it| BagFiles::find(it));
    let files = files.collect::<Result<Vec<_>, _>>()?;
    let mut work = Work::begin(&files)?;
    let mut bags = Vec::new();
    for files in &files {
        bags.extend(work.open(files, "copying")?);
    }
    let filter = match choice {
        Some(choice) => {
            choice.check(&bags, iter::empty())?;
            choice.filter(bags.iter().filter_map(|it| it.report().start_ns).min())
        }
        None => Filter::default(),
    };
    let (to, compression) = (&target.output, compression.into());
    let observe = &mut |it| work.advance(it);
    let report = sm2_bag::copy_observed(&bags, to, &filter, compression, observe);
    let report = report.map_err(|it| work.error(it))?;
    print(&target.output, &report, target.json)?;
    Ok(ended(&report))
}
