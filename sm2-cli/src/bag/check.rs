use std::path::PathBuf;

use clap::Args;

use super::work::Work;
use crate::{bag_summary::show, ended::Ended, error::CliError, output::Output};

/// `sm2 bag check`.
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
Exit status: 0 the bag is whole, 1 it is damaged or incomplete, 2 wrong usage.

Examples:
  sm2 bag check drive.mcap";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let mut work = Work::begin([arguments.file.as_path()])?;
    let verdict = sm2_bag::check_observed(&arguments.file, &mut |it| work.note(it));
    let verdict = verdict.map_err(|it| work.error(it))?;
    let mut out = Output::new();
    if arguments.json {
        out.json(&verdict)?;
    } else {
        show(&mut out, &arguments.file, &verdict.report)?;
        for damage in &verdict.damages {
            out.line(format_args!("damage: {damage}"))?;
        }
        if verdict.damages.is_empty() {
            out.line("no damage")?;
        }
    }
    out.flush()?;
    Ok(match verdict.damages.is_empty() {
        true => Ended::Done,
        false => Ended::No,
    })
}
