use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sm2_bag::{BagFiles, Damage, Report};

use super::work::Work;
use crate::{bag_summary::show, ended::Ended, error::CliError, output::Output};

/// `sm2 bag check`.
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
Exit status: 0 the bag is whole, 1 it is damaged or incomplete, 2 wrong usage.

Examples:
  sm2 bag check drive.mcap";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Checked<'a> {
    damages: Vec<Damage>,
    report: Report,
    /// The files, if the bag is a folder.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    files: Vec<CheckedFile<'a>>,
}

#[derive(Serialize)]
struct CheckedFile<'a> {
    path: &'a Path,
    damages: &'a [Damage],
}

/// Runs the command.
///
/// # Errors
///
/// [`CliError::ReadBag`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let files = BagFiles::find(&arguments.file)?;
    let mut work = Work::begin([&files])?;
    let verdicts = files.check(&mut |it| work.advance(it));
    let verdicts = verdicts.map_err(|it| work.error(it))?;
    let reports: Vec<_> = verdicts.iter().map(|it| it.report.clone()).collect();
    let checked = Checked {
        damages: verdicts.iter().flat_map(|it| it.damages.clone()).collect(),
        report: Report::of_files(&reports),
        files: match arguments.file.is_dir() {
            true => files
                .paths()
                .iter()
                .zip(&verdicts)
                .map(|(path, it)| CheckedFile {
                    path,
                    damages: &it.damages,
                })
                .collect(),
            false => Vec::new(),
        },
    };
    let is_whole = checked.damages.is_empty();
    Output::new().answer(arguments.json, &checked, |out| {
        show(out, &arguments.file, &checked.report)?;
        for (path, verdict) in files.paths().iter().zip(&verdicts) {
            for damage in &verdict.damages {
                match checked.files.is_empty() {
                    true => out.line(format_args!("damage: {damage}"))?,
                    false => out.line(format_args!("damage: {}: {damage}", path.display()))?,
                }
            }
        }
        match is_whole {
            true => out.line("no damage"),
            false => Ok(()),
        }
    })?;
    Ok(Ended::with_answer(is_whole))
}
