//! The figures of a run.

use std::time::{Duration, Instant};

use crate::tally::Tally;

/// So many lines about faults are printed.
const LINES: usize = 100;
/// The time between two lines of progress.
const PROGRESS: Duration = Duration::from_secs(5);

/// The figures so far.
#[derive(Debug)]
pub(crate) struct Report {
    start: Instant,
    printed: Instant,
    lines: usize,
    pub(crate) tally: Tally,
    pub(crate) kills: u64,
    pub(crate) takeovers: u64,
    pub(crate) stops: u64,
    pub(crate) faults: u64,
    pub(crate) rests: u64,
    /// The greatest number of descriptors that a process held beyond those of the first rest, or
    /// beyond those before its first declaration at the end.
    pub(crate) fd_delta: u64,
    /// The same for mappings of messages and rings.
    pub(crate) mapping_delta: u64,
    /// The same for private memory, in KiB.
    pub(crate) rss_delta: u64,
    /// Processes and files that are left at the end.
    pub(crate) residue: u64,
}

impl Report {
    pub(crate) fn new() -> Self {
        Self {
            start: Instant::now(),
            printed: Instant::now(),
            lines: 0,
            tally: Tally::default(),
            kills: 0,
            takeovers: 0,
            stops: 0,
            faults: 0,
            rests: 0,
            fd_delta: 0,
            mapping_delta: 0,
            rss_delta: 0,
            residue: 0,
        }
    }

    /// Adds the progress of a process between two of its tallies.
    pub(crate) const fn add(&mut self, before: &Tally, now: &Tally) {
        self.tally.checked += now.checked - before.checked;
        self.tally.remote += now.remote - before.remote;
        self.tally.damaged += now.damaged - before.damaged;
        self.tally.unaccounted += now.unaccounted - before.unaccounted;
        self.tally.errors += now.errors - before.errors;
    }

    /// Prints a line about something that must not happen.
    pub(crate) fn wrong(&mut self, line: &str) {
        self.lines += 1;
        if self.lines <= LINES {
            println!("{:>5} s  {line}", self.start.elapsed().as_secs());
        }
    }

    /// As [`wrong`](Self::wrong), and counts an error.
    pub(crate) fn error(&mut self, line: &str) {
        self.tally.errors += 1;
        self.wrong(line);
    }

    /// Prints the figures if the last line is old enough.
    pub(crate) fn progress(&mut self) {
        if self.printed.elapsed() < PROGRESS {
            return;
        }
        self.printed = Instant::now();
        let Tally {
            checked,
            remote,
            damaged,
            unaccounted,
            errors,
        } = self.tally;
        println!(
            "{:>5} s  {checked} checked ({remote} remote), {damaged} damaged, {unaccounted} unaccounted, \
             {errors} errors; \
             {} kills, {} take-overs, {} stops, {} faults, {} rests",
            self.start.elapsed().as_secs(),
            self.kills,
            self.takeovers,
            self.stops,
            self.faults,
            self.rests
        );
    }

    fn figures(&self) -> [(&'static str, u64); 15] {
        [
            ("seconds", self.start.elapsed().as_secs()),
            ("messages_checked", self.tally.checked),
            ("remote_checked", self.tally.remote),
            ("damaged", self.tally.damaged),
            ("unaccounted", self.tally.unaccounted),
            ("errors", self.tally.errors),
            ("kills", self.kills),
            ("takeovers", self.takeovers),
            ("stops", self.stops),
            ("faults", self.faults),
            ("rests", self.rests),
            ("fd_delta", self.fd_delta),
            ("mapping_delta", self.mapping_delta),
            ("rss_delta", self.rss_delta),
            ("residue", self.residue),
        ]
    }

    /// Prints all figures: a JSON object in one line, or a table.
    pub(crate) fn print(&self, json: bool) {
        if json {
            let figures = self.figures();
            let members: Vec<String> = figures
                .map(|(key, value)| format!("\"{key}\":{value}"))
                .into();
            println!("{{{}}}", members.join(","));
            return;
        }
        for (key, value) in self.figures() {
            println!("{key:<16} {value}");
        }
        println!("rss_delta is in KiB; a line above names each process that has grown too much");
    }

    /// Whether nothing was wrong: messages were checked, remote ones too, and no figure of a fault is above its limit.
    pub(crate) const fn is_clean(&self) -> bool {
        let Tally {
            checked,
            remote,
            damaged,
            unaccounted,
            errors,
        } = self.tally;
        checked > 0
            && remote > 0
            && damaged + unaccounted + errors == 0
            && self.fd_delta + self.mapping_delta + self.residue == 0
            && self.lines == 0
    }
}

#[cfg(test)]
mod tests {
    use super::Report;

    #[test]
    fn each_fault_counts() {
        let clean = || {
            let mut report = Report::new();
            report.tally.checked = 1;
            report.tally.remote = 1;
            report.kills = 7;
            report
        };
        assert!(clean().is_clean());
        let faults: [fn(&mut Report); 9] = [
            |it| it.tally.checked = 0,
            |it| it.tally.remote = 0,
            |it| it.tally.damaged = 1,
            |it| it.tally.unaccounted = 1,
            |it| it.error("a process ended"),
            |it| it.fd_delta = 1,
            |it| it.mapping_delta = 1,
            |it| it.wrong("a process has grown"),
            |it| it.residue = 1,
        ];
        for (index, fault) in faults.into_iter().enumerate() {
            let mut report = clean();
            fault(&mut report);
            assert!(!report.is_clean(), "fault {index}");
        }
    }
}
