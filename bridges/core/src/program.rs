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

/// A bridge that a program runs.
pub trait Program: Sized {
    /// A checked configuration.
    type Config;
    /// The reason why a file is no configuration.
    type ConfigError: Error + 'static;
    /// The reason why a bridge cannot start, or go on.
    type Error: Error + 'static;

    /// Reads and checks a configuration.
    ///
    /// # Errors
    ///
    /// The file is no configuration of this bridge.
    fn load(path: &Path) -> Result<Self::Config, Self::ConfigError>;

    /// The rules of a configuration.
    fn rules(config: &Self::Config) -> &RuleTables;

    /// Joins the domain.
    ///
    /// # Errors
    ///
    /// The bridge cannot start.
    fn start(config: &Self::Config) -> Result<Self, Self::Error>;

    /// Carries messages until `shutdown` is requested.
    ///
    /// # Errors
    ///
    /// The bridge cannot go on.
    fn run(&mut self, shutdown: &Shutdown) -> Result<(), Self::Error>;

    /// The messages since the start, for people.
    fn summary(&self) -> String;
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

/// Runs the command line of the program with this name. Its log goes to the standard error output.
pub fn main<P: Program>(name: &str) -> ExitCode {
    tracing_subscriber::fmt()
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal())
        .init();
    match execute::<P>(Arguments::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{name}: {error}");
            ExitCode::FAILURE
        }
    }
}

fn execute<P: Program>(command: Command) -> Result<(), Box<dyn Error>> {
    match command {
        Command::Run { config } => carry::<P>(&P::load(&config)?),
        Command::Check { config } => {
            let checked = P::load(&config)?;
            println!(
                "{}: {} rules",
                config.display(),
                P::rules(&checked).notes.len()
            );
            Ok(())
        }
        Command::Explain {
            config,
            name,
            service,
        } => {
            let config = P::load(&config)?;
            let name = Name::typed(&name).map_err(|error| format!("wrong name: {error}"))?;
            explain(P::rules(&config), &name, service);
            Ok(())
        }
    }
}

fn carry<P: Program>(config: &P::Config) -> Result<(), Box<dyn Error>> {
    let shutdown = Shutdown::new()?;
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let mut bridge = P::start(config)?;
    eprintln!("the bridge carries messages");
    let requested = shutdown.clone();
    thread::spawn(move || {
        if signals.forever().next().is_some() {
            requested.request();
        }
    });
    bridge.run(&shutdown)?;
    println!("{}", bridge.summary());
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
