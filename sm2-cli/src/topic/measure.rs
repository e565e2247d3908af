//! The common part of `hz`, `bw`, `delay` and `loss`: they wait for the topic, and then read the counters of
//! its nodes once per interval.

use std::{collections::BTreeSet, os::fd::AsFd, slice, time::Duration};

use clap::Args;
use serde::Serialize;
use serde_json::json;
use sm2_io::clock;
use sm2_proto::{
    EntityId, Kind, Name, NodeId,
    counters::{Entry, Rate},
    domain::LinkView,
};

use crate::{
    args::{self, Domain},
    columns::{Row, Stream},
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    follow::Follow,
    names,
    output::Output,
    sampling::{Sample, Sampler},
    time,
    view::{TOPIC, View},
    wait::For,
};

/// The arguments of each of these commands.
#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// The topic
    #[arg(value_name = "NAME", value_parser = args::name)]
    topic: Name,
    /// The time between two reports, such as 200ms
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = time::span)]
    interval: Duration,
    /// Exit after this number of reports
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Fail if there is nothing to measure for this time [default: 10s with --count, else no limit]
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    timeout: Option<Duration>,
    /// Print each report as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

/// The default of `--timeout` for a command that ends by itself: it must not wait forever.
const TIMEOUT_WITH_COUNT: Duration = Duration::from_secs(10);

impl Arguments {
    /// The longest wait for something to measure; `None` for a command that only a signal ends.
    fn timeout(&self) -> Option<Duration> {
        self.timeout
            .or_else(|| self.count.map(|_| TIMEOUT_WITH_COUNT))
    }
}

/// The help of one of these commands: its own text, and its examples.
macro_rules! help {
    ($own:literal, $examples:literal) => {
        concat!(
            $own,
            "

The command reads counters that every node keeps: it does not subscribe, and publishers do not notice
it. It waits for a topic that does not exist yet; with --count, for 10 s (see --timeout).

Exit status: 0 ended by Ctrl-C or after --count reports, 1 failed, 2 wrong usage, 130 Ctrl-C before
--count reports were made.

Examples:
",
            $examples
        )
    };
}

pub(super) use help;

/// One of these commands, as a row of its reports.
pub(super) trait Measure: Row + Serialize {
    /// The role of the command's node, a part of the node's name.
    const ROLE: &str;
    /// The kind of interface whose counters a report needs.
    const OF: Kind;
    /// The name of a report's rows in JSON.
    const ROWS: &str;
    /// The number of leading columns that hold texts.
    const TEXTS: usize;

    /// The rows of a report.
    fn rows(look: &Look<'_>) -> Vec<Self>;
}

/// The input of a report: the domain, and two samples of its counters.
pub(super) struct Look<'a> {
    pub(super) view: View<'a>,
    topic: &'a Name,
    /// The kind of interface that is measured.
    of: Kind,
    pub(super) now: &'a Sample,
    pub(super) before: &'a Sample,
}

impl Look<'_> {
    /// The rows of the topic's interfaces whose nodes keep counters.
    pub(super) fn of_interfaces<R>(&self, row: impl Fn(EntityId, &Entry) -> R) -> Vec<R> {
        let rows = self.counted().map(|(entity, entry)| row(entity, entry));
        rows.collect()
    }

    /// The rows of the links of these interfaces.
    pub(super) fn of_links<R>(&self, row: impl Fn(&LinkView) -> Option<R>) -> Vec<R> {
        let interfaces = self.counted();
        let links = interfaces.flat_map(|(entity, _)| self.view.links_of(entity));
        links.filter_map(row).collect()
    }

    /// The rate of an interface. `None` for one that came during the interval.
    pub(super) fn rate(&self, entity: EntityId) -> Option<Rate> {
        self.now.rate(self.before, self.view.domain, entity)
    }

    fn counted(&self) -> impl Iterator<Item = (EntityId, &Entry)> {
        let all = self.view.on(self.topic, slice::from_ref(&self.of));
        let entry = |entity| self.now.interface(self.view.domain, entity);
        all.filter_map(move |it| Some((it.entity, entry(it.entity)?)))
    }
}

/// Prints reports until a signal comes, the reader of the output ends, or `--count` reports were printed.
pub(super) fn run<M: Measure>(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.domain, M::ROLE)?;
    let mut follow = Follow::new(&command_node, arguments.domain.connect_timeout)?;
    let mut sampler = Sampler::new();
    let mut printer = Printer::<M>::new(arguments);
    let mut before: Option<Sample> = None;
    let mut due = clock::now();
    let mut reports = 0;
    while arguments.count.is_none_or(|count| reports < count) {
        if !is_there(&follow, &arguments.topic, M::OF) {
            before = None;
            if !await_topic(&command_node, &mut follow, arguments, M::OF, &printer.out)? {
                return Ok(ended(&command_node, arguments));
            }
            due = clock::now();
        }
        let nodes = nodes_on(&follow, &arguments.topic);
        let now = sampler.look(&command_node.node, follow.domain(), &nodes)?;
        if let Some(before) = &before {
            let look = Look {
                view: View::new(follow.domain()),
                topic: &arguments.topic,
                of: M::OF,
                now: &now,
                before,
            };
            printer.print(&look)?;
            reports += 1;
        }
        before = Some(now);
        // Reports stay on a fixed grid. After a late report the grid starts anew.
        due = due.after(arguments.interval).max(clock::now());
        let last = arguments.count == Some(reports);
        if !last && !follow.sleep(&printer.out, due)? {
            return Ok(ended(&command_node, arguments));
        }
    }
    Ok(Ended::Done)
}

/// The result after a signal or the end of the reader. Without `--count`, both are the regular end.
fn ended(command_node: &CommandNode, arguments: &Arguments) -> Ended {
    match command_node.stopped() {
        Some(signal) if arguments.count.is_some() => Ended::Stopped(signal),
        _ => Ended::Done,
    }
}

fn is_there(follow: &Follow<'_>, topic: &Name, kind: Kind) -> bool {
    let mut interfaces = follow.domain().interfaces();
    interfaces
        .any(|it| it.refused.is_none() && it.contract.kind() == kind && it.contract.name() == topic)
}

/// The nodes with an interface on a topic.
fn nodes_on(follow: &Follow<'_>, topic: &Name) -> BTreeSet<NodeId> {
    let view = View::new(follow.domain());
    view.on(topic, TOPIC).map(|it| it.entity.node).collect()
}

/// Waits until the topic has an interface to measure. Returns false if the command should end instead.
///
/// # Errors
///
/// [`CliError::NothingToMeasure`] after the timeout.
fn await_topic(
    command_node: &CommandNode,
    follow: &mut Follow<'_>,
    arguments: &Arguments,
    kind: Kind,
    out: &Output,
) -> Result<bool, CliError> {
    let topic = &arguments.topic;
    let start = clock::now();
    let timeout = arguments.timeout();
    let until = timeout.map(|timeout| start.after(timeout));
    let view = View::new(follow.domain());
    let known = view.names(TOPIC);
    let hint = match known.contains(topic) {
        true => String::new(),
        false => names::hint(topic.as_str(), known),
    };
    stderr_line!("sm2: waiting for a {kind} of {topic} (Ctrl-C ends){hint}");
    while !is_there(follow, topic, kind) {
        let woken = follow.wait(&[(out.as_fd(), For::Hangup)], until)?;
        if command_node.stopped().is_some() || woken.ready == [true] {
            return Ok(false);
        }
        if let Some(timeout) = timeout.filter(|timeout| clock::now().since(start) >= *timeout) {
            return Err(CliError::NothingToMeasure {
                topic: topic.clone(),
                kind,
                seconds: timeout.as_secs_f64(),
            });
        }
    }
    Ok(true)
}

/// Prints reports.
struct Printer<'a, M> {
    arguments: &'a Arguments,
    out: Output,
    table: Stream<M>,
    /// The nodes that were already reported as nodes without counters.
    named: BTreeSet<Name>,
}

impl<'a, M: Measure> Printer<'a, M> {
    fn new(arguments: &'a Arguments) -> Self {
        Self {
            arguments,
            out: Output::new(),
            table: Stream::new(M::TEXTS),
            named: BTreeSet::new(),
        }
    }

    fn print(&mut self, look: &Look<'_>) -> Result<(), CliError> {
        for node in &look.now.silent {
            if self.named.insert(node.clone()) {
                stderr_line!(
                    "sm2: node {node} keeps no counters: what it does is not in these figures"
                );
            }
        }
        let rows = M::rows(look);
        if self.arguments.json {
            let interval = look.now.since(look.before).as_secs_f64();
            self.out.json(&json!({
                "topic": look.topic.as_str(),
                "time_ns": clock::now().0,
                "interval_s": thousandths(interval),
                "without_counters": look.now.silent.iter().map(Name::as_str).collect::<Vec<_>>(),
                M::ROWS: rows,
            }))?;
        } else {
            for line in self.table.lines(&rows) {
                self.out.line(line)?;
            }
        }
        self.out.flush()
    }
}

fn thousandths(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
