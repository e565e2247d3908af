//! `sm2 play`: publishes the messages of bags again.

mod control;
mod keys;
mod progress;

use std::{ops::ControlFlow, path::PathBuf};

use clap::{Args, Subcommand};
use sm2_bag::{Bag, BagFiles, PlayOptions, PlayReport, Player};
use sm2_node::Node;
use sm2_proto::{Name, text::Counted};

use self::{
    keys::{HINT, Keys},
    progress::{Range, ShownProgress},
};
use crate::{
    args::{Domain, name, rate},
    bag_choice::Choice,
    connect::CommandNode,
    ended::Ended,
    error::CliError,
    output::Output,
};

/// `sm2 play`.
#[derive(Args, Debug)]
#[command(after_help = HELP, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    action: Option<Action>,
    /// The bags, files or folders; several are played as one, in the order of the times of their messages
    #[arg(value_name = "BAG", required = true)]
    files: Vec<PathBuf>,
    /// The speed: 1 as recorded, 2 twice as fast, 0 as fast as possible
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = rate)]
    rate: f64,
    #[command(flatten)]
    choice: Choice,
    /// Publish the messages of topic FROM on topic TO (may be given again)
    #[arg(long, value_name = "FROM=TO", value_parser = remapping)]
    remap: Vec<(Name, Name)>,
    /// Publish each topic with this prefix, so PREFIX/TOPIC
    #[arg(long, value_name = "PREFIX", value_parser = name)]
    prefix: Option<Name>,
    /// Wait for this number of subscribers of each topic before the first message
    #[arg(long, value_name = "N", default_value_t = 0)]
    wait: usize,
    /// Give the nodes their original names; otherwise --name stands before them, and one node plays for more than 64
    #[arg(long)]
    as_original: bool,
    /// The name of this replay: the names of its nodes begin with it, so two replays at once need different ones
    #[arg(long, value_name = "NAME", value_parser = name, default_value = "play")]
    name: Name,
    /// Play again and again, until Ctrl-C
    #[arg(long = "loop")]
    again: bool,
    /// Be the source of domain time: nodes that use it follow the times of the messages
    #[arg(long)]
    clock: bool,
    /// Wait for this number of members, and then let domain time go on only when all of them have handled their inputs
    #[arg(long, value_name = "MEMBERS", conflicts_with = "again")]
    lockstep: Option<usize>,
    /// Begin with a pause
    #[arg(long)]
    paused: bool,
    /// The service for `sm2 play control`
    #[arg(long, value_name = "NAME", value_parser = name, default_value = control::SERVICE)]
    service: Name,
    /// Print the result as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

/// The commands below `sm2 play`.
#[derive(Debug, Subcommand)]
enum Action {
    /// Pause, step or speed up a running `sm2 play`
    Control(control::Arguments),
}

const HELP: &str = "\
Each recorded publisher gets a publisher with the same type and QoS. The first message waits, for at most
10 s, until the subscribers that the domain has are linked. Reliable subscribers without room hold up the
next message for at most 10 s. Messages that subscribers missed are counted at the end.

With --start, the messages that a late subscriber would have got from latched publishers at that time come
first. Damaged parts of a bag are left out, and named at the end.

With --clock, nodes that use domain time follow the times of the messages. With --lockstep, the domain time
also waits for the members: nodes that handle their inputs in turns. Their outputs are then the same in each
replay, at any --rate. A domain has one source of time, so both leave out what was recorded on topic clock,
unless --remap gives it another name.

A terminal shows the progress: the recorded time that is reached, of how much, and the number of messages.
Keys on a terminal, without --json: space pauses and resumes; s or the right arrow publishes the next message
of a pause; + and - double and halve the rate; q ends. `sm2 play control` does the same from another shell,
and so does a call of --service with a string: pause, resume, step, or rate and a number. During a pause,
nothing is published and domain time stands still. In lockstep, a step has all messages of the next time.

Bags of ROS 2 (rosbag2, or the Python package rosbags) are played as well, if they have definitions in
ros2msg. Topics lose the slash at their start, and the node of the publishers is `play/bag`.

Exit status: 0 all messages were published, the key q, or Ctrl-C with --loop; 1 failed, parts are damaged, or a
topic has another type in the domain and was left out; 2 wrong usage; 130 Ctrl-C.

Examples:
  sm2 play drive.mcap --rate 0
  sm2 play drive.mcap --topic chatter --remap chatter=old/chatter --rate 2 --json
  sm2 play drive.mcap drive.mcap --rate 0
  sm2 play drive.mcap --prefix second --name second --exclude 'camera/**' --rate 0";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::Play`], [`CliError::ReadBag`], and the errors of connecting.
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    if let Some(Action::Control(arguments)) = &arguments.action {
        return control::run(arguments);
    }
    let mut bags = Vec::new();
    for path in &arguments.files {
        bags.extend(BagFiles::find(path)?.open(&mut |_| ControlFlow::Continue(()))?);
    }
    for bag in bags.iter().filter(|it| !it.is_complete()) {
        let path = bag.path().display();
        stderr_line!("sm2: {path} is incomplete: playing what can be read");
    }
    let command_node = CommandNode::open(&arguments.domain, "play")?;
    let played = play(arguments, &bags, &command_node)?;
    Output::new().answer(arguments.json, &played, |out| show(out, &played))?;
    Ok(match command_node.stopped() {
        Some(signal) if !arguments.again => Ended::Stopped(signal),
        _ => Ended::with_answer(played.damaged.is_empty() && played.left_out.is_empty()),
    })
}

/// Plays the bags, with `--loop` until a signal or a key ends it.
fn play(
    arguments: &Arguments,
    bags: &[Bag],
    command_node: &CommandNode,
) -> Result<PlayReport, CliError> {
    let topics = arguments.remap.iter().map(|(from, _)| from.as_str());
    arguments.choice.check(bags, topics)?;
    let starts = bags.iter().filter_map(|it| it.report().start_ns);
    let filter = arguments.choice.filter(starts.min());
    let range = Range::new(bags, &filter);
    let options = PlayOptions {
        filter,
        rate: arguments.rate,
        paused: arguments.paused,
        remap: arguments.remap.iter().cloned().collect(),
        topic_prefix: arguments.prefix.clone(),
        original_names: arguments.as_original,
        name: arguments.name.clone(),
        subscribers: arguments.wait,
        clock: arguments.clock,
        lockstep: arguments.lockstep,
        ..PlayOptions::default()
    };
    let socket = arguments.domain.path()?;
    let connect = |name: &str| {
        let builder = Node::builder(name).socket(&socket);
        builder
            .manager_timeout(arguments.domain.connect_timeout)
            .connect()
    };
    let mut player = Player::new(bags, options, connect, command_node.signal_fd())?;
    if player.omits_clock() {
        stderr_line!(
            "sm2: the recorded topic clock is left out: domain time is that of this replay"
        );
    }
    if let Some(nodes) = player.merged_nodes() {
        stderr_line!(
            "sm2: node {}/bag publishes for the {nodes} nodes of the recording (--as-original: their own names)",
            arguments.name
        );
    }
    // A policy may allow the topics, but not the service.
    if let Err(error) = player.serve(&command_node.node, &arguments.service) {
        stderr_line!("sm2: `sm2 play control` does not reach this replay: {error}");
    }
    let control = player.control();
    let keys = match arguments.json {
        true => None,
        false => {
            Keys::start(control.clone(), command_node).map_err(CliError::system("read keys"))?
        }
    };
    if keys.is_some() {
        stderr_line!("{HINT}");
    }
    let _shown = (!arguments.json).then(|| ShownProgress::start(control.clone(), range));
    loop {
        let played = player.play()?;
        if !arguments.again || command_node.stopped().is_some() || control.has_ended() {
            return Ok(played);
        }
    }
}

/// Prints the result.
fn show(out: &mut Output, played: &PlayReport) -> Result<(), CliError> {
    for member in &played.left {
        out.line(format_args!("{member} left the lockstep before the end"))?;
    }
    for topic in &played.topics {
        out.line(format_args!(
            "{}: {}, {} without a subscriber, {} missed by subscribers",
            topic.name,
            Counted::new(topic.messages, "message"),
            topic.unheard,
            topic.missed
        ))?;
    }
    for left_out in &played.left_out {
        out.line(format_args!(
            "{}: NOT PLAYED: {}",
            left_out.topic, left_out.reason
        ))?;
    }
    for part in &played.damaged {
        out.line(format_args!("left out as damaged: {part}"))?;
    }
    Ok(())
}

/// Parses `FROM=TO`.
fn remapping(text: &str) -> Result<(Name, Name), String> {
    let (from, to) = text.split_once('=').ok_or("give two topics as FROM=TO")?;
    Ok((name(from)?, name(to)?))
}
