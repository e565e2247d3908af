//! `sm2 doctor`: checks this machine, the Manager and the domain, and names a remedy for each problem.
//! It changes nothing.
//!
//! [`socket`] checks the socket and its folder, [`manager`] the Manager and its domain, [`connections`] the subscribers
//! without links, and [`machine`] the limits of the kernel.

mod check;
mod connections;
mod machine;
mod manager;
mod socket;

use std::cmp::Reverse;

use clap::Args;
use serde::Serialize;
use sm2_node::Node;

pub(crate) use self::check::Check;
use self::check::Level;
use crate::{
    args::Domain,
    columns::Table,
    ended::Ended,
    error::CliError,
    interrupt::Interrupt,
    limits::{self, LimitsInForce, Quota},
    observation::Readings,
    output::Output,
    troubles::LinkTroubles,
    view::View,
};

/// `sm2 doctor`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    limits: limits::Shown,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Each check is ok, warn or bad. A check that is not ok comes first and names a remedy. Below the checks are
the limits of the Manager that are used by 80 % or more; --limits shows all of them, each with its greatest
use and the option that sets it. doctor changes nothing.
A subscriber without a link is named if a publisher of its topic does not offer what it demands, or if a
publisher whose topic has a similar name has no subscriber.
If messages were dropped or deadlines missed before, doctor reads the counters again a second later.

Exit status: 0 no check is bad, 1 a check is bad, 2 wrong usage.

Examples:
  sm2 doctor
  sm2 doctor --domain arm
  sm2 doctor --json | jq '.checks[] | select(.level != \"ok\")'";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Report {
    /// The worst level of all checks.
    level: Level,
    checks: Vec<Check>,
    /// The limits in force at the Manager; `None` if they are not known.
    limits: Option<LimitsInForce>,
    /// The use of the limits.
    quotas: Vec<Quota>,
}

/// Runs all checks.
///
/// # Errors
///
/// [`CliError::Output`], [`CliError::DomainSocket`] if there is no such domain.
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let interrupt = Interrupt::install().map_err(CliError::system("catch signals"))?;
    let path = arguments.domain.path()?;
    let mut checks = socket::checks(&arguments.domain, &path);
    let found = manager::look(&arguments.domain, &path, &interrupt);
    checks.extend(found.checks);
    checks.extend(machine::checks(found.nodes));
    if let Some(signal) = interrupt.signal() {
        return Ok(Ended::Stopped(signal));
    }
    let level = checks.iter().map(|check| check.level).max();
    let report = Report {
        level: level.unwrap_or(Level::Ok),
        checks,
        limits: found.limits,
        quotas: found.quotas,
    };
    Output::new().answer(arguments.json, &report, |out| {
        print(out, &report.checks)?;
        let (limits, quotas) = (report.limits.as_ref(), &report.quotas);
        out.table_below(&limits::rows(limits, quotas, arguments.limits))
    })?;
    Ok(Ended::with_answer(report.level < Level::Bad))
}

/// The checks that need nothing but a domain and this machine. `node` is the node of the command.
pub(crate) fn checks(view: &View<'_>, readings: Readings<'_>, node: &Node) -> Vec<Check> {
    let troubles = LinkTroubles::of_all(view, readings);
    let quotas = limits::quotas(view);
    let mut checks = Vec::from(manager::domain(view, &quotas, &troubles, node));
    checks.extend(machine::checks(Some(view.domain.nodes().count() as u64)));
    checks
}

/// Prints the checks, those that are not ok first.
fn print(out: &mut Output, checks: &[Check]) -> Result<(), CliError> {
    let mut checks = checks.to_vec();
    checks.sort_by_key(|it| Reverse(it.level));
    let table = Table(&checks).to_string();
    let mut lines = table.lines();
    lines.next().map_or(Ok(()), |headings| out.line(headings))?;
    for (check, line) in checks.iter().zip(lines) {
        let (meaning, word) = (check.level.meaning(), check.level.word());
        out.meant(meaning, word.len(), line)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
