//! `sm2 play`: publishes the messages of bags again.

use std::path::PathBuf;

use clap::Args;
use sm2_bag::{Bag, PlayOptions, Player};
use sm2_node::Node;
use sm2_proto::{Name, text::Counted};

use crate::{
    args::{Domain, name},
    bag_choice::Choice,
    connect::Session,
    ended::Ended,
    error::CliError,
    output::Output,
};

/// `sm2 play`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The bags; several are played as one, in the order of the times of their messages
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// The speed: 1 as recorded, 2 twice as fast, 0 as fast as possible
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = rate)]
    rate: f64,
    #[command(flatten)]
    choice: Choice,
    /// Publish the messages of topic FROM on topic TO (may be given again)
    #[arg(long, value_name = "FROM=TO", value_parser = remapping)]
    remap: Vec<(Name, Name)>,
    /// Wait for this number of subscribers of each topic before the first message
    #[arg(long, value_name = "N", default_value_t = 0)]
    wait: usize,
    /// Give the nodes their original names; otherwise play/ stands before them
    #[arg(long)]
    as_original: bool,
    /// Play again and again, until Ctrl-C
    #[arg(long = "loop")]
    again: bool,
    /// Print the result as one line of JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Each recorded publisher gets a publisher with the same type and QoS. The first message waits, for at most
10 s, until the subscribers that the domain has are linked. Reliable subscribers without room hold up the
next message for at most 10 s. Messages that subscribers missed are counted at the end.

An incomplete bag is played up to its last part that is whole.

Exit status: 0 all messages were published, or Ctrl-C with --loop; 1 failed; 2 wrong usage; 130 Ctrl-C.

Examples:
  sm2 play drive.mcap --rate 0
  sm2 play drive.mcap --topic chatter --remap chatter=old/chatter --rate 2 --json
  sm2 play drive.mcap drive.mcap --rate 0";

/// Runs the command.
///
/// # Errors
///
/// [`CliError::Play`], [`CliError::ReadBag`], and the errors of connecting.
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let bags: Vec<_> =
        (arguments.files.iter().map(|it| Bag::open(it))).collect::<Result<_, _>>()?;
    for bag in bags.iter().filter(|it| !it.is_complete()) {
        let path = bag.path().display();
        stderr_line!("sm2: {path} is incomplete: playing the part that is whole");
    }
    let starts = bags.iter().filter_map(|it| it.report().start_ns);
    let session = Session::open(&arguments.domain, "play")?;
    let options = PlayOptions {
        filter: arguments.choice.filter(starts.min()),
        rate: arguments.rate,
        remap: arguments.remap.iter().cloned().collect(),
        original_names: arguments.as_original,
        subscribers: arguments.wait,
        ..PlayOptions::default()
    };
    let socket = arguments.domain.path()?;
    let connect = |name: &str| {
        let builder = Node::builder(name).socket(&socket);
        builder
            .manager_timeout(arguments.domain.connect_timeout)
            .connect()
    };
    let mut player = Player::new(&bags, options, connect, session.signal_fd())?;
    let played = loop {
        let played = player.play()?;
        if !arguments.again || session.stopped().is_some() {
            break played;
        }
    };
    let mut out = Output::new();
    if arguments.json {
        out.json(&played)?;
    } else {
        for topic in &played.topics {
            out.line(format_args!(
                "{}: {}, {} without a subscriber, {} missed by subscribers",
                topic.name,
                Counted::new(topic.messages, "message"),
                topic.unheard,
                topic.missed
            ))?;
        }
    }
    out.flush()?;
    Ok(match session.stopped() {
        Some(signal) if !arguments.again => Ended::Stopped(signal),
        _ => Ended::Done,
    })
}

/// Parses a speed.
fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if rate.is_finite() && rate >= 0.0 => Ok(rate),
        _ => Err("give a factor of 0 or more, such as 2 or 0.5".into()),
    }
}

/// Parses `FROM=TO`.
fn remapping(text: &str) -> Result<(Name, Name), String> {
    let (from, to) = text.split_once('=').ok_or("give two topics as FROM=TO")?;
    Ok((name(from)?, name(to)?))
}
