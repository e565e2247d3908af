//! The command line of the programs of bridges.

use std::error::Error;
use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::thread;

use clap::{Parser, Subcommand};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use sm2_node::Shutdown;
use sm2_proto::Name;
use sm2_proto::gateway::{Direction, SubjectKind};

use crate::config::RuleTables;

/// The parts of a program: `C` is its configuration, `B` its bridge.
#[derive(Clone, Copy, Debug)]
pub struct Program<L, R, S, U, T> {
    /// Reads and checks a configuration: `Fn(&Path) -> Result<C, _>`.
    pub load: L,
    /// The rules of a configuration: `Fn(&C) -> &RuleTables`.
    pub rules: R,
    /// Joins the domain: `Fn(&C) -> Result<B, _>`.
    pub start: S,
    /// Carries messages until it is requested to end: `Fn(&mut B, &Shutdown) -> Result<(), _>`.
    pub run: U,
    /// The messages since the start, for people: `Fn(&B) -> String`.
    pub summary: T,
}

/// Joins a domain of SM2 to another network.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Carry messages until SIGINT or SIGTERM
    Run {
        /// The configuration
        #[arg(value_name = "FILE")]
        config: PathBuf,
    },
    /// Check a configuration
    Check {
        /// The configuration
        #[arg(value_name = "FILE")]
        config: PathBuf,
    },
    /// Say whether a topic may pass, and which rule decides
    Explain {
        /// The configuration
        #[arg(value_name = "FILE")]
        config: PathBuf,
        /// The topic or service
        #[arg(value_name = "NAME")]
        name: String,
        /// The name is that of a service
        #[arg(long)]
        service: bool,
    },
}

impl<L, R, S, U, T> Program<L, R, S, U, T> {
    /// Runs the command line of the program with this name. Its log goes to the standard error output.
    pub fn main<C, B, F, E>(self, name: &str) -> ExitCode
    where
        L: Fn(&Path) -> Result<C, F>,
        R: Fn(&C) -> &RuleTables,
        S: Fn(&C) -> Result<B, E>,
        U: Fn(&mut B, &Shutdown) -> Result<(), E>,
        T: Fn(&B) -> String,
        F: Error + 'static,
        E: Error + 'static,
    {
        tracing_subscriber::fmt()
            .with_writer(io::stderr)
            .with_ansi(io::stderr().is_terminal())
            .init();
        match self.execute(Arguments::parse().command) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("{name}: {error}");
                ExitCode::FAILURE
            }
        }
    }

    fn execute<C, B, F, E>(self, command: Command) -> Result<(), Box<dyn Error>>
    where
        L: Fn(&Path) -> Result<C, F>,
        R: Fn(&C) -> &RuleTables,
        S: Fn(&C) -> Result<B, E>,
        U: Fn(&mut B, &Shutdown) -> Result<(), E>,
        T: Fn(&B) -> String,
        F: Error + 'static,
        E: Error + 'static,
    {
        match command {
            Command::Run { config } => {
                let config = (self.load)(&config)?;
                let shutdown = Shutdown::new()?;
                let mut bridge = (self.start)(&config)?;
                eprintln!("the bridge carries messages");
                end_with_signals(&shutdown)?;
                (self.run)(&mut bridge, &shutdown)?;
                println!("{}", (self.summary)(&bridge));
            }
            Command::Check { config } => {
                let checked = (self.load)(&config)?;
                let rules = (self.rules)(&checked).notes.len();
                println!("{}: {rules} rules", config.display());
            }
            Command::Explain {
                config,
                name,
                service,
            } => {
                let config = (self.load)(&config)?;
                let name = Name::typed(&name).map_err(|error| format!("wrong name: {error}"))?;
                explain((self.rules)(&config), &name, service);
            }
        }
        Ok(())
    }
}

/// Requests the end of the bridge with SIGINT or SIGTERM.
fn end_with_signals(shutdown: &Shutdown) -> io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let requested = shutdown.clone();
    thread::spawn(move || {
        if signals.forever().next().is_some() {
            requested.request();
        }
    });
    Ok(())
}

fn explain(rules: &RuleTables, name: &Name, is_service: bool) {
    let kind = match is_service {
        true => SubjectKind::Service,
        false => SubjectKind::Topic,
    };
    for (direction, word) in [(Direction::Out, "out"), (Direction::In, "in")] {
        let decision = rules.explain(kind, name, direction);
        let verdict = match decision.is_allowed {
            true => "allowed",
            false => "denied",
        };
        match decision.line {
            Some(line) => {
                let durable = if decision.is_durable { ", durable" } else { "" };
                println!("{word}: {verdict} by the rule at line {line}{durable}");
            }
            None => println!("{word}: {verdict}, no rule matches"),
        }
    }
}
