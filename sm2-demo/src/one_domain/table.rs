//! The tables of the demo. While it runs, it shows a table, or a line each second if the output cannot
//! be redrawn; at the end, it shows a summary. Lines have at most 79 columns, so that terminals do not
//! wrap them.

use std::time::Duration;

use sm2_proto::text::Counted;

use super::{child::Part, meter::Cost, part::Figures, report::Report};
use crate::output::size_text;

/// The counts and the costs of one process.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// `None` for the Manager, which runs in the director's process and has no counts.
    pub(crate) part: Option<(Part, Figures)>,
    /// The costs since the last measurement.
    pub(crate) cost: Cost,
}

/// A table with a line for each row, and the sums of their costs.
pub(crate) fn table(rows: &[Row]) -> Vec<String> {
    let heading = cells(
        "",
        ["messages", "Hz", "p50 us", "p99 us", "lost", "damaged"].map(String::from),
        ["CPU %", "PSS MB"].map(String::from),
    );
    let lines = rows.iter().map(|row| {
        let who = row
            .part
            .map_or("Manager".into(), |(part, _)| part.to_string());
        cells(&who, counts(row), costs(row.cost))
    });
    let total = cells("together", Default::default(), costs(together(rows)));
    [heading].into_iter().chain(lines).chain([total]).collect()
}

/// All rows in a single line, with the worst figures of all subscribers.
pub(crate) fn line(elapsed: Duration, rows: &[Row]) -> String {
    let receivers = || {
        rows.iter()
            .filter_map(|row| row.part)
            .filter_map(of_subscriber)
    };
    let most = |of: fn(&Figures) -> f64| receivers().map(|it| of(&it)).fold(0.0, f64::max);
    let slowest = receivers().map(|it| it.hz).reduce(f64::min).unwrap_or(0.0);
    let lost: u64 = receivers().map(|it| it.lost).sum();
    let damaged: u64 = receivers().map(|it| it.damaged).sum();
    let [cpu, pss] = costs(together(rows));
    format!(
        "{:>4.0} s  {slowest:.1} Hz  p50 {} us  p99 {} us  lost {lost}  damaged {damaged}  \
         CPU {cpu} %  PSS {pss} MB",
        elapsed.as_secs_f64(),
        micros(most(|it| it.latency_us.p50), 0),
        micros(most(|it| it.latency_us.p99), 0),
    )
}

/// The summary of the whole run.
pub(crate) fn summary(report: &Report) -> Vec<String> {
    let heading = format!(
        "{:<14}{:>9}{:>8}{:>9}{:>9}{:>9}{:>10}{:>10}",
        "", "received", "lost", "damaged", "Hz", "p50 us", "p99 us", "max us"
    );
    let subscribers = report.subscribers.iter().zip(1..).map(|(it, number)| {
        format!(
            "{:<14}{:>9}{:>8}{:>9}{:>9.2}{:>9}{:>10}{:>10}",
            format!("subscriber {number}"),
            it.received,
            it.lost,
            it.damaged,
            it.hz,
            micros(it.latency_us.p50, 1),
            micros(it.latency_us.p99, 1),
            micros(it.latency_us.max, 1),
        )
    });
    let pss = report.pss_bytes_total.map_or("unknown".into(), megabytes);
    let total = format!(
        "{} of {} published in {} s, {}; all processes together: CPU {:.1} %, PSS {pss} MB",
        Counted::new(report.published, "message"),
        size_text(report.size_bytes),
        report.wall_s,
        report.integrity,
        report.cpu_percent_total,
    );
    [heading]
        .into_iter()
        .chain(subscribers)
        .chain([total])
        .collect()
}

fn cells(who: &str, counts: [String; 6], costs: [String; 2]) -> String {
    let [messages, hz, p50, p99, lost, damaged] = counts;
    let [cpu, pss] = costs;
    format!("{who:<14}{messages:>9}{hz:>8}{p50:>9}{p99:>9}{lost:>7}{damaged:>8}{cpu:>7}{pss:>8}")
}

fn counts(row: &Row) -> [String; 6] {
    let Some((part, figures)) = row.part else {
        return Default::default();
    };
    let mut cells: [String; 6] = Default::default();
    cells[0] = figures.messages.to_string();
    cells[1] = format!("{:.1}", figures.hz);
    if of_subscriber((part, figures)).is_some() {
        cells[2] = micros(figures.latency_us.p50, 1);
        cells[3] = micros(figures.latency_us.p99, 1);
        cells[4] = figures.lost.to_string();
        cells[5] = figures.damaged.to_string();
    }
    cells
}

fn of_subscriber((part, figures): (Part, Figures)) -> Option<Figures> {
    matches!(part, Part::Subscriber(_)).then_some(figures)
}

fn costs(cost: Cost) -> [String; 2] {
    let pss = cost.pss_bytes.map_or("-".into(), megabytes);
    [format!("{:.1}", cost.cpu_percent), pss]
}

fn together(rows: &[Row]) -> Cost {
    let pss_bytes: u64 = rows.iter().filter_map(|row| row.cost.pss_bytes).sum();
    Cost {
        cpu_percent: rows.iter().map(|row| row.cost.cpu_percent).sum(),
        pss_bytes: Some(pss_bytes).filter(|&bytes| bytes > 0),
    }
}

/// Formats a latency; zero means that there was no message.
fn micros(latency: f64, decimals: usize) -> String {
    match latency {
        0.0 => "-".into(),
        latency => format!("{latency:.decimals$}"),
    }
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1}", bytes as f64 / 1e6)
}

#[cfg(test)]
mod tests;
