use std::{
    fs,
    ops::ControlFlow,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use serde::Serialize;
use sm2_bag::{Bag, BagFiles, Report};

use crate::{
    columns::{Column, Row},
    ended::Ended,
    error::CliError,
    report::{self, List},
    size::Size,
    time::Span,
};

/// `sm2 bag ls`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The folder; its own folders are not searched, but may be bags
    #[arg(value_name = "FOLDER", default_value = ".")]
    folder: PathBuf,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

const HELP: &str = "\
The bags are the files with the ending .mcap, .mcap.zst or .mcap.zstd, and the folders with the metadata.yaml
of rosbag2, in the order of their names. A bag whose recorder was killed is INCOMPLETE. A bag that cannot be
read is told on standard error. A compressed file is decompressed to be listed.

Exit status: 0 all bags are listed, 1 a bag cannot be read, 2 wrong usage.

Examples:
  sm2 bag ls
  sm2 bag ls . --json";

#[derive(Serialize)]
struct Listed {
    path: PathBuf,
    /// The length of the file, or of all files.
    file_bytes: u64,
    topics: usize,
    messages: u64,
    lost: u64,
    start_ns: Option<u64>,
    end_ns: Option<u64>,
    complete: bool,
}

/// Runs the command.
///
/// # Errors
///
/// [`CliError::File`], [`CliError::Output`].
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let paths = bag_paths(&arguments.folder)?;
    let mut ended = Ended::Done;
    let (name, mut rows) = ("bags", Vec::new());
    for path in paths {
        match listed(&path) {
            Ok(bag) => rows.push(bag),
            Err(error) => {
                stderr_line!("sm2: {error}");
                ended = Ended::No;
            }
        }
    }
    report::print(&List { name, rows }, arguments.json)?;
    Ok(ended)
}

/// The paths of the bags in a folder, sorted.
fn bag_paths(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let failed = |source| CliError::file("read the folder", folder, source);
    let mut paths = sm2_bag::bags_in(folder).map_err(failed)?;
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.join("metadata.yaml").is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

fn listed(path: &Path) -> Result<Listed, CliError> {
    let files = BagFiles::find(path)?;
    let bags = files.open(&mut |_| ControlFlow::Continue(()))?;
    let reports: Vec<_> = bags.iter().map(Bag::report).collect();
    let report = Report::of_files(&reports);
    let mut file_bytes = 0;
    for path in files.paths() {
        let metadata = fs::metadata(path);
        file_bytes += metadata
            .map_err(|error| CliError::file("read", path, error))?
            .len();
    }
    Ok(Listed {
        path: path.to_owned(),
        file_bytes,
        topics: report.topics.len(),
        messages: sum(report.topics.iter().map(|it| it.messages)),
        lost: sum(report.topics.iter().map(|it| it.lost)),
        start_ns: report.start_ns,
        end_ns: report.end_ns,
        complete: report.complete,
    })
}

/// The sum of counts. A hostile bag can claim any.
fn sum(counts: impl Iterator<Item = u64>) -> u64 {
    counts.fold(0, u64::saturating_add)
}

impl Row for Listed {
    const COLUMNS: &'static [Column<Self>] = &[
        ("BAG", |it| it.path.display().to_string()),
        ("SIZE", |it| Size(it.file_bytes).to_string()),
        ("LENGTH", |it| match (it.start_ns, it.end_ns) {
            (Some(start), Some(end)) => {
                Span(Duration::from_nanos(end.saturating_sub(start))).to_string()
            }
            _ => "-".to_owned(),
        }),
        ("TOPICS", |it| it.topics.to_string()),
        ("MESSAGES", |it| it.messages.to_string()),
        ("LOST", |it| it.lost.to_string()),
        ("STATE", |it| match it.complete {
            true => "complete".to_owned(),
            false => "INCOMPLETE".to_owned(),
        }),
    ];
}
