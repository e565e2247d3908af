//! Copies bags with other times of their messages.

use std::{path::PathBuf, time::Duration};

use clap::Args;
use sm2_bag::BagFiles;
use sm2_proto::text::Counted;

use super::work::Work;
use crate::{
    bag_summary::{ended, show, time_of_day},
    compression::Compression,
    ended::Ended,
    error::CliError,
    output::Output,
    time::Span,
};

/// `sm2 bag restamp`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The recording, a file or a folder, which is not changed
    #[arg(value_name = "BAG")]
    file: PathBuf,
    /// The new bag
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// How the new bag is compressed
    #[arg(long, value_enum, default_value_t = Compression::None)]
    compression: Compression,
    /// Print what was changed as one line of JSON
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
This is for a recording during which the wall clock was corrected, such as that of a computer which started
in 1970. The times of a recording follow the wall clock as it was at the start. The new bag has the times that
the clock would have shown if it had always been as it was after its last step. So all times move by the same
span: those of messages, gaps and missing topics. An existing file is never overwritten.

A bag of another program, and one of several recordings, cannot be corrected.

Exit status: 0 the new bag is written, 1 failed, nothing to correct, or parts are damaged, 2 wrong usage.

Examples:
  sm2 bag restamp 1970.mcap -o corrected.mcap";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::RestampBag`], [`CliError::CopyBag`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let files = BagFiles::find(&arguments.file)?;
    let mut work = Work::begin([&files])?;
    let bags = work.open(&files, "copying")?;
    let (to, compression) = (&arguments.output, arguments.compression.into());
    let restamped = sm2_bag::restamp(&bags, to, compression, &mut |it| work.advance(it));
    let restamped = restamped.map_err(|it| work.error(it))?;
    Output::new().answer(arguments.json, &restamped, |out| {
        let shift = restamped.shift_ns;
        let nanos = u64::try_from(shift.unsigned_abs()).unwrap_or(u64::MAX);
        out.line(format_args!(
            "all times are {} {}: the wall clock had {} during the recording, the last one at {}",
            Span(Duration::from_nanos(nanos)),
            if shift < 0 { "earlier" } else { "later" },
            Counted::new(restamped.steps as u64, "step"),
            time_of_day(restamped.corrected_at_ns),
        ))?;
        show(out, to, &restamped.report)
    })?;
    Ok(ended(&restamped.report))
}
