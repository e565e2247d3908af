//! `sm2 top`: rates and losses of a domain, live.
//!
//! [`figures`] computes each [`table`], [`history`] keeps the rates of the last intervals, [`state`] handles keys,
//! [`draw`] lays out the screen, and [`screen`] owns the terminal.

mod draw;
mod figures;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
mod history;
mod screen;
mod state;
mod table;

use std::{
    io::{self, IsTerminal},
    os::fd::AsFd,
    time::Duration,
};

use clap::Args;
use sm2_io::clock;
use sm2_proto::Instant;

pub(crate) use self::figures::InterfaceFigures;
use self::{
    figures::{Figures, Tab},
    history::History,
    screen::Screen,
    state::{After, State},
};
use crate::{
    args::Domain,
    colours,
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    follow::Follow,
    observation::Readings,
    output::Output,
    process::ProcessorUse,
    sampling::{Sample, Sampler},
    time,
    view::View,
    wait::For,
};

/// `sm2 top`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The time between two updates, such as 500ms
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = time::span)]
    interval: Duration,
    /// Print the figures of one interval as text, and exit
    #[arg(long)]
    once: bool,
    /// Print them as one JSON object, and exit
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
top reads counters that every node keeps. It does not subscribe, and publishers do not notice it.

Keys: q quits; Tab or the left and right arrows switch between topics and nodes; up and down (or k
and j) move; s sorts by the next column, r the other way round; / filters by name (Enter keeps it,
Esc drops it). A `-` is a figure of a node that keeps no counters.

DROPPED and LOST are totals; LOSS/s has the messages of each second that subscribers did not get, and
MISS/s the missed deadlines. HELD has the samples that subscribers hold. STALL s is the time that a
subscriber or server has taken nothing while messages waited, from 2 s on. The screen shows MISS/s, HELD
and STALL s only while a deadline is missed or an end takes nothing. A delay in brackets is old: no message
was taken in the interval. CPU % is the processor time of the node's process; 100 is one core.

On a narrow screen whole columns are left out, in this order. Topics: TYPE, LINKS, PUBS, SUBS, HELD,
DROPPED, MISS/s, P50 ms, MB/s, LOST, LOSS/s, STALL s, HZ. Nodes: IFACES, LINKS, PID, HELD, DROPPED,
IN MB/s, OUT MB/s, MISS/s, LOST, CPU %, LOSS/s, IN/s, STALL s, OUT/s. The column that sorts the
rows is left out last; --once and --json have all columns.

On a wide screen, TREND has the messages per second of each of the last intervals, 120 at most, the
newest at the right; the highest block is the largest of them. Losses are red where the terminal has
colours and the variable NO_COLOR is not set.

Exit status: 0 ended by q, Ctrl-C, SIGTERM or the end of its terminal, 1 failed, 2 wrong usage (also: no terminal).

Examples:
  sm2 top
  sm2 top --interval 200ms
  sm2 top --once
  sm2 top --json | jq '.topics[] | select(.lost > 0)'";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::NoTerminal`] without a terminal, unless one interval is printed. Any other [`CliError`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let once = arguments.once || arguments.json;
    let has_person = io::stdin().is_terminal() && io::stdout().is_terminal();
    if !(once || has_person) {
        return Err(CliError::NoTerminal);
    }
    let command_node = CommandNode::open(&arguments.domain, "top")?;
    let mut monitor = Monitor {
        follow: Follow::new(&command_node, arguments.domain.connect_timeout)?,
        command_node: &command_node,
        sampler: Sampler::new(),
        processors: ProcessorUse::default(),
        before: None,
    };
    match once {
        true => print(arguments, &mut monitor),
        false => watch(arguments, &mut monitor).or_else(|error| match screen::is_closed() {
            true => Ok(Ended::Done),
            false => Err(error),
        }),
    }
}

/// The source of the figures.
struct Monitor<'a> {
    command_node: &'a CommandNode,
    follow: Follow<'a>,
    sampler: Sampler,
    processors: ProcessorUse,
    before: Option<Sample>,
}

impl Monitor<'_> {
    /// The figures since the last call. The figures of the first call have no rates.
    fn look(&mut self) -> Result<Figures, CliError> {
        let domain = self.follow.domain();
        let nodes = domain.nodes().map(|node| node.node).collect();
        let now = self.sampler.look(&self.command_node.node, domain, &nodes)?;
        self.processors.look(domain.nodes());
        let readings = Readings {
            before: self.before.as_ref(),
            now: &now,
        };
        let itself = self.command_node.node.name();
        let figures = Figures::new(&View::new(domain), readings, &self.processors, itself);
        self.before = Some(now);
        Ok(figures)
    }
}

/// Prints the figures of one interval.
fn print(arguments: &Arguments, monitor: &mut Monitor<'_>) -> Result<Ended, CliError> {
    let mut out = Output::new();
    monitor.look()?;
    let due = clock::now().after(arguments.interval);
    if !monitor.follow.sleep(&out, due)? {
        monitor.command_node.fail_if_stopped()?;
        return Ok(Ended::Done);
    }
    let figures = monitor.look()?;
    if arguments.json {
        out.json(&figures.json())?;
    } else {
        for tab in [Tab::Topics, Tab::Nodes] {
            for line in draw::text(&figures, tab) {
                out.line(line)?;
            }
        }
    }
    Ok(Ended::Done)
}

/// Updates the screen until a key or a signal ends the command.
fn watch(arguments: &Arguments, monitor: &mut Monitor<'_>) -> Result<Ended, CliError> {
    monitor.command_node.be_silent();
    let mut state = State {
        colours: colours::are_wanted(),
        ..State::default()
    };
    let mut history = History::default();
    let mut figures = monitor.look()?;
    let mut due = clock::now().after(arguments.interval);
    let mut screen = Screen::open().map_err(CliError::Output)?;
    let input = io::stdin();
    loop {
        state.connected = monitor.command_node.is_connected();
        let drawn = screen.draw(|frame| draw::draw(frame, &figures, &history, &mut state));
        drawn.map_err(CliError::Output)?;
        let woken = monitor
            .follow
            .wait(&[(input.as_fd(), For::Reading)], Some(due))?;
        if monitor.command_node.stopped().is_some() {
            return Ok(Ended::Done);
        }
        if woken.ready == [true] {
            for key in screen
                .keys()
                .map_err(CliError::system("read the keyboard"))?
            {
                if state.key(key, &figures) == After::Quit {
                    return Ok(Ended::Done);
                }
            }
        }
        let now = clock::now();
        if now >= due {
            figures = monitor.look()?;
            history.add(&figures);
            due = next(due, now, arguments.interval);
        }
    }
}

/// The time of the next update. Updates stay on a fixed grid; after a late update the grid starts anew.
fn next(due: Instant, now: Instant, interval: Duration) -> Instant {
    due.after(interval).max(now)
}
