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

use crate::config::{ConfigError, RuleTables};
use crate::error::BridgeError;

/// The parts of a program: `C` is its configuration, `E` a wrong value of it, and `B` the bridge.
#[derive(Clone, Copy, Debug)]
pub struct Program<C, E: Error, B> {
    /// Reads and checks a configuration.
    pub load: fn(&Path) -> Result<C, ConfigError<E>>,
    /// The rules of a configuration.
    pub rules: fn(&C) -> &RuleTables,
    /// Joins the domain.
    pub start: fn(&C) -> Result<B, BridgeError>,
    /// Carries messages until the bridge is requested to end.
    pub run: fn(&mut B, &Shutdown) -> Result<(), BridgeError>,
    /// The messages since the start, for people.
    pub summary: fn(&B) -> String,
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

impl<C, E: Error + 'static, B> Program<C, E, B> {
    /// Runs the command line of the program with this name. Its log goes to the standard error output.
    pub fn main(self, name: &str) -> ExitCode {
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

    fn execute(self, command: Command) -> Result<(), Box<dyn Error>> {
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
