//! The frame of the commands that ask the domain once, and print the answer. The lists and `info` use all of it, others
//! only its options or only [`print`].

use clap::Args;
use serde::{Serialize, Serializer};

use crate::{
    args::Domain,
    columns::{Row, Table},
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    output::Output,
    view::View,
};

/// The answer of a command. `--json` prints it as one object.
pub(crate) trait Report: Serialize {
    /// The lines for people.
    fn text(&self) -> String;
}

/// Prints a report.
///
/// # Errors
///
/// [`CliError::Output`].
pub(crate) fn print(report: &impl Report, json: bool) -> Result<(), CliError> {
    Output::new().answer(json, report, |out| out.line(report.text()))
}

/// The options of a command that asks the domain once, and prints the answer.
#[derive(Args, Debug)]
pub(crate) struct Options {
    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) domain: Domain,
}

impl Options {
    /// Prints a report on the domain at one revision. `role` is a part of the name of the command's node.
    ///
    /// # Errors
    ///
    /// Those of [`CommandNode::open`] and of `report`, [`CliError::Query`], [`CliError::Output`].
    pub(crate) fn print<R: Report>(
        &self,
        role: &str,
        report: impl FnOnce(&CommandNode, &View<'_>) -> Result<R, CliError>,
    ) -> Result<Ended, CliError> {
        let command_node = CommandNode::open(&self.domain, role)?;
        let domain = command_node.snapshot()?;
        let report = Dated {
            revision: domain.revision(),
            report: report(&command_node, &View::new(&domain))?,
        };
        print(&report, self.json)?;
        Ok(Ended::Done)
    }
}

/// A report with the revision of the domain that it is about.
#[derive(Serialize)]
struct Dated<R> {
    revision: u64,
    #[serde(flatten)]
    report: R,
}

impl<R: Report> Report for Dated<R> {
    fn text(&self) -> String {
        self.report.text()
    }
}

/// A list: a table, and in JSON an array under a name.
pub(crate) struct List<R> {
    pub(crate) name: &'static str,
    pub(crate) rows: Vec<R>,
}

impl<R: Row + Serialize> Report for List<R> {
    fn text(&self) -> String {
        Table(&self.rows).to_string()
    }
}

impl<R: Serialize> Serialize for List<R> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map([(self.name, &self.rows)])
    }
}

/// A line for each fact, with the values below each other.
pub(crate) fn facts(facts: &[(&str, &str)]) -> Vec<String> {
    let labels = facts.iter().map(|(label, _)| label.chars().count());
    let width = labels.max().unwrap_or(0);
    let line = |(label, value): &(&str, &str)| format!("{label:<width$}  {value}");
    facts.iter().map(line).collect()
}
