use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use sm2_io::clock;
use sm2_manager::PolicyFile;
use sm2_proto::{control::Change, domain::Domain as Mirror};

use super::learned::Learned;
use crate::{
    args, args::Domain, connect::CommandNode, ended::Ended, error::CliError, follow::Follow,
    output::Output,
};

/// `sm2 policy learn`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// Watch the domain for this time; Ctrl-C ends the watch earlier [default: one look]
    #[arg(long, value_name = "SECONDS", value_parser = args::positive)]
    seconds: Option<f64>,
    /// Make each topic exclusive that never had two publishers at a time
    #[arg(long)]
    exclusive: bool,
    /// Write the policy to this file instead of standard output
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    domain: Domain,
}

const HELP: &str = "\
Writes a policy that denies by default and allows what the domain does: each node, with its user, may
publish, subscribe, serve and call the names that it uses now or used during the watch. Users of the
domain see everything and read all counters. A node whose name contains the number of its process has
another name next time: its rights belong to its user. The command does not learn from its own node, nor
from interfaces that were refused or that the present policy hides from it.

Exit status: 0 done, 1 failed, 2 wrong usage.

Examples:
  sm2 policy learn
  sm2 policy learn --seconds 2 --exclusive -o learned.toml";

/// Runs the command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.domain, "policy")?;
    let itself = command_node.node.name();
    let mut learned = Learned::new(arguments.exclusive);
    if let Some(seconds) = arguments.seconds {
        let time = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX);
        let until = clock::now().after(time);
        let mut follow = Follow::new(&command_node, arguments.domain.connect_timeout)?;
        learned.learn(follow.domain(), &all_of(follow.domain()), itself);
        while clock::now() < until && command_node.stopped().is_none() {
            let woken = follow.wait(&[], Some(until))?;
            learned.learn(follow.domain(), &woken.changes, itself);
        }
    }
    match command_node.snapshot() {
        Ok(domain) => learned.learn(&domain, &all_of(&domain), itself),
        // A watch does not lose what it has learned.
        Err(_) if arguments.seconds.is_some() => {}
        Err(error) => return Err(error),
    }
    let text = learned.to_string();
    let file = arguments.output.as_deref();
    // A domain may have more names than a policy.
    PolicyFile::parse(file.unwrap_or(Path::new("learned policy")), &text)?;
    match file {
        Some(path) => fs::write(path, text).map_err(|it| CliError::file("write", path, it))?,
        None => {
            let mut out = Output::new();
            out.write(|out| std::io::Write::write_all(out, text.as_bytes()))?;
        }
    }
    Ok(Ended::Done)
}

/// All items of a domain, as changes of an empty one.
fn all_of(domain: &Mirror) -> Vec<Change> {
    let items = domain.items().cloned();
    items.map(|item| Change::Set { item }).collect()
}
