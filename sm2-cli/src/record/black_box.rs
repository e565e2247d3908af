//! `sm2 record --last`: keeps the last seconds of topics when something happens.

use std::{
    fs,
    os::fd::AsFd,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use serde_json::json;
use signal_hook::consts::SIGUSR1;
use sm2_bag::{
    BlackBox, BlackBoxOptions, BlackBoxStep, Incident, Options, Progress, RecordError, Trigger,
    numbered,
};
use sm2_io::clock;
use sm2_node::{ConnectError, Node};
use sm2_proto::{Instant, Name, text::Counted};

use super::{
    common::{SO_FAR, Shown, Unmatched, say_unmatched},
    trigger::SERVICE,
};
use crate::{
    args::name, bag_summary::show, connect::CommandNode, error::CliError, interrupt::SignalPipe,
    output::Output, ticker::Ticker, time,
};

/// The options of a black box.
#[derive(Args, Debug)]
#[command(next_help_heading = "Black box")]
pub(super) struct BlackBoxArguments {
    /// Keep the last messages, of this time, and write them to a bag when something triggers
    #[arg(long, value_name = "TIME", value_parser = time::span)]
    #[arg(conflicts_with_all = ["split_size", "split_time", "max_size"])]
    pub(super) last: Option<Duration>,
    /// How much after a trigger is written as well
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = time::span_or_zero, requires = "last")]
    after: Duration,
    /// Trigger on each message of this topic (may be given again)
    #[arg(long, value_name = "TOPIC", value_parser = name, requires = "last")]
    on_message: Vec<Name>,
    /// Trigger when this node, once it was there, has left the domain (may be given again)
    #[arg(long, value_name = "NODE", value_parser = name, requires = "last")]
    on_lost: Vec<Name>,
    /// Trigger when a topic has had messages, but none for this time (may be given again)
    #[arg(long, value_name = "TOPIC=TIME", value_parser = deadline, requires = "last")]
    on_deadline: Vec<(Name, Duration)>,
    /// The service that triggers
    #[arg(long, value_name = "NAME", value_parser = name, default_value = SERVICE, requires = "last")]
    service: Name,
    /// The folder for the last messages, such as one in /dev/shm [default: ring in the folder of the bags]
    #[arg(long, value_name = "FOLDER", requires = "last")]
    ring: Option<std::path::PathBuf>,
}

/// Parses `TOPIC=TIME`.
fn deadline(text: &str) -> Result<(Name, Duration), String> {
    let (topic, span) = text
        .split_once('=')
        .ok_or("give a topic and a time, such as scan=200ms")?;
    Ok((name(topic)?, time::span(span)?))
}

/// Runs until a signal comes or the time `until`. Returns whether a topic was missing, or a message too long.
///
/// # Errors
///
/// [`CliError::Record`], [`CliError::Incident`], [`CliError::File`].
pub(super) fn run<'a>(
    arguments: &BlackBoxArguments,
    last: Duration,
    (output, record): (&Path, Options),
    (until, json): (Instant, bool),
    command_node: &'a CommandNode,
    connect: impl FnMut() -> Result<Node, ConnectError> + Send + 'a,
) -> Result<bool, CliError> {
    fs::create_dir_all(output).map_err(|error| CliError::file("create", output, error))?;
    let options = BlackBoxOptions {
        record,
        last,
        after: arguments.after,
        triggers: arguments.triggers(),
        output: output.to_owned(),
        ring: PathBuf::new(),
    };
    let signal = SignalPipe::install(SIGUSR1).map_err(CliError::system("catch SIGUSR1"))?;
    let (ring, started) = match &arguments.ring {
        Some(ring) => (ring.clone(), start(command_node, &options, ring)),
        None => start_in(command_node, &options, output),
    };
    let failed = |source| CliError::Record {
        path: ring.clone(),
        source,
    };
    let mut black_box = started.map_err(failed)?;
    black_box.connect_with(connect);
    let added = black_box.wake_on_descriptor(signal.as_fd());
    added.map_err(CliError::system("wait for SIGUSR1"))?;
    arguments.warn_of_absent(command_node)?;
    stderr_line!(
        "keeping the last {} in {} (`sm2 record trigger`, SIGUSR1; Ctrl-C ends)",
        time::Span(last),
        ring.display()
    );
    let mut out = Output::new();
    let mut failure = Ok(());
    let kept = keep(
        &mut black_box,
        &signal,
        command_node,
        until,
        &mut |incident| report(&mut out, incident, json, &mut failure),
    );
    let Progress {
        missing, too_long, ..
    } = black_box.progress();
    let unmatched = black_box.unmatched();
    say_unmatched(&unmatched, black_box.domain(), "was there");
    if missing > 0 {
        let topics = Counted::new(missing as u64, "topic");
        stderr_line!("sm2: {topics} not recorded for a time: see the messages before, or the bags");
    }
    if too_long > 0 {
        let messages = Counted::new(too_long, "message");
        stderr_line!("sm2: {messages} left out: longer than --max-len");
    }
    let incidents = black_box.finish();
    let kept = kept?;
    for incident in incidents.map_err(failed)? {
        report(&mut out, incident, json, &mut failure)?;
    }
    kept.map_err(failed)?;
    failure.map(|()| missing > 0 || too_long > 0)
}

fn start<'a>(
    command_node: &'a CommandNode,
    options: &BlackBoxOptions,
    ring: &Path,
) -> Result<BlackBox<'a>, RecordError> {
    let options = BlackBoxOptions {
        ring: ring.to_owned(),
        ..options.clone()
    };
    BlackBox::start(&command_node.node, options, command_node.signal_fd())
}

/// Starts with a ring in the folder of the bags: that of a recorder that was killed, if there is one, else a new one.
fn start_in<'a>(
    command_node: &'a CommandNode,
    options: &BlackBoxOptions,
    output: &Path,
) -> (PathBuf, Result<BlackBox<'a>, RecordError>) {
    let mut number = 1;
    loop {
        let ring = output.join(numbered("ring", number));
        match start(command_node, options, &ring) {
            Err(RecordError::RingInUse) => number += 1,
            started => return (ring, started),
        }
    }
}

/// Records, and passes each incident that is complete to `done`.
fn keep(
    black_box: &mut BlackBox<'_>,
    signal: &SignalPipe,
    command_node: &CommandNode,
    until: Instant,
    done: &mut dyn FnMut(Incident) -> Result<(), CliError>,
) -> Result<Result<(), RecordError>, CliError> {
    let (mut ticker, mut unmatched) = (Ticker::new(), Unmatched::new());
    while command_node.stopped().is_none() && clock::now() < until {
        match black_box.step(unmatched.left(ticker.left(until))) {
            Ok(BlackBoxStep::Stopped) => break,
            Ok(BlackBoxStep::Timeout) => {}
            Ok(BlackBoxStep::Woken) => {
                if signal.has_come() {
                    let (path, is_merged) = black_box.trigger("SIGUSR1");
                    if !is_merged {
                        stderr_line!("triggered by SIGUSR1: {}", path.display());
                    }
                }
            }
            Ok(BlackBoxStep::Triggered(reason, path)) => {
                stderr_line!("triggered by {reason}: {}", path.display());
            }
            Ok(BlackBoxStep::Written(incident)) => done(incident)?,
            Ok(BlackBoxStep::NoRoom(path)) => stderr_line!(
                "sm2: {} waits: its disk would have less room than --min-free",
                path.display()
            ),
            Err(error) => return Ok(Err(error)),
        }
        command_node.is_connected();
        ticker.tick(|| Shown(black_box.progress()));
        if unmatched.is_due() {
            say_unmatched(&black_box.unmatched(), black_box.domain(), SO_FAR);
        }
    }
    Ok(Ok(()))
}

/// Prints the bag of an incident. The first one that could not be written is the result of the command.
fn report(
    out: &mut Output,
    incident: Incident,
    json: bool,
    failure: &mut Result<(), CliError>,
) -> Result<(), CliError> {
    let Incident {
        path,
        reason,
        result,
        merged,
        ..
    } = incident;
    if merged > 0 {
        let triggers = Counted::new(merged, "more trigger");
        stderr_line!("sm2: {} stands for {triggers}", path.display());
    }
    match result {
        Ok(report) if json => {
            out.json(&json!({ "path": path, "reason": reason, "merged": merged, "bag": report }))?;
        }
        Ok(report) => show(out, &path, &report)?,
        Err(error) => {
            stderr_line!("sm2: {error}");
            if failure.is_ok() {
                *failure = Err(CliError::Incident { path, reason });
            }
        }
    }
    out.flush()
}

impl BlackBoxArguments {
    /// Names the nodes of `--on-lost` that are not there: they may come later, or their names may be wrong.
    fn warn_of_absent(&self, command_node: &CommandNode) -> Result<(), CliError> {
        if self.on_lost.is_empty() {
            return Ok(());
        }
        let domain = command_node.snapshot()?;
        let absent = |node: &&Name| domain.node_named(node.as_str()).is_none();
        for node in self.on_lost.iter().filter(absent) {
            stderr_line!("sm2: no node {node} is there: it triggers when it has come and left");
        }
        Ok(())
    }

    fn triggers(&self) -> Vec<Trigger> {
        let messages = self.on_message.iter().cloned().map(Trigger::Message);
        let nodes = self.on_lost.iter().cloned().map(Trigger::LostNode);
        let deadlines = self.on_deadline.iter().cloned();
        let deadlines = deadlines.map(|(topic, time)| Trigger::MissedDeadline(topic, time));
        let service = Trigger::Service(self.service.clone());
        let others = messages.chain(nodes).chain(deadlines);
        others.chain([service]).collect()
    }
}
