//! `sm2-bridge-zenoh`: a bridge between a domain of SM2 and a network of Zenoh.

use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread;

use clap::{Parser, Subcommand};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use sm2_bridge_zenoh::{Bridge, BridgeError, Config, ConfigError};
use sm2_node::Shutdown;
use sm2_proto::gateway::{Direction, SubjectKind};
use sm2_proto::{Name, NameError};

/// Joins a domain of SM2 to a network of Zenoh.
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

#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    #[error("wrong name: {0}")]
    Name(#[from] NameError),
    #[error("the operating system refuses a resource: {0}")]
    System(#[from] io::Error),
}

fn main() -> ExitCode {
    tracing_subscriber::fmt()
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal())
        .init();
    let arguments = Arguments::parse();
    match run(arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("sm2-bridge-zenoh: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> Result<(), Failure> {
    match command {
        Command::Run { config } => carry(&Config::load(&config)?),
        Command::Check { config } => {
            let checked = Config::load(&config)?;
            println!("{}: {} rules", config.display(), checked.rules.0.len());
            Ok(())
        }
        Command::Explain {
            config,
            name,
            service,
        } => explain(&Config::load(&config)?, &Name::typed(&name)?, service),
    }
}

fn carry(config: &Config) -> Result<(), Failure> {
    let shutdown = Shutdown::new()?;
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let mut bridge = Bridge::start(config)?;
    eprintln!("the bridge {} carries messages", config.name);
    let requested = shutdown.clone();
    thread::spawn(move || {
        if signals.forever().next().is_some() {
            requested.request();
        }
    });
    bridge.run(&shutdown)?;
    println!("{}", bridge.counts());
    Ok(())
}

fn explain(config: &Config, name: &Name, is_service: bool) -> Result<(), Failure> {
    let kind = match is_service {
        true => SubjectKind::Service,
        false => SubjectKind::Topic,
    };
    for (direction, word) in [(Direction::Out, "out"), (Direction::In, "in")] {
        let decision = config.explain(kind, name, direction);
        let verdict = match decision.is_allowed {
            true => "allowed",
            false => "denied",
        };
        match decision.line {
            Some(line) => println!("{word}: {verdict} by the rule at line {line}"),
            None => println!("{word}: {verdict}, no rule matches"),
        }
    }
    Ok(())
}
