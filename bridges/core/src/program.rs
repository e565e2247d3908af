//! The command line of the programs of bridges.

use std::error::Error;
use std::io::{self, IsTerminal};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::thread;

use clap::{Parser, Subcommand};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use sm2_gateway::DomainLocation;
use sm2_gateway::metrics::Server;
use sm2_node::Shutdown;
use sm2_node::domain::Domain;
use sm2_proto::Name;
use sm2_proto::gateway::{Direction, SubjectKind};

use crate::account::ReadAccount;
use crate::config::{ConfigError, RuleTables};
use crate::error::BridgeError;
use crate::shadow::{Shadow, lets_out};

/// The status of a wrong command line, and of a wrong level of the log.
const WRONG_USAGE: u8 = 2;

/// The parts of a program: `C` is its configuration, `E` a wrong value of it, and `B` the bridge.
#[derive(Clone, Copy, Debug)]
pub struct Program<C, E: Error, B> {
    /// Reads and checks a configuration.
    pub load: fn(&Path) -> Result<C, ConfigError<E>>,
    /// The domain and the rules of a configuration.
    pub parts: fn(&C) -> (&DomainLocation, &RuleTables),
    /// Joins the domain.
    pub start: fn(&C) -> Result<B, BridgeError>,
    /// Compares with other rules while the bridge runs, and logs each difference.
    pub set_shadow: fn(&mut B, Shadow),
    /// Carries messages until the bridge is requested to end.
    pub run: fn(&mut B, &Shutdown) -> Result<(), BridgeError>,
    /// The messages since the start.
    pub account: fn(&B) -> ReadAccount,
}

const HELP: &str =
    "SM2_LOG (error, warn, info, debug) sets the level of the log on standard error.";

/// Joins a domain of SM2 to another network.
#[derive(Parser)]
#[command(version, after_help = HELP)]
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
        /// Log what the rules of this configuration would change, without effect
        #[arg(long, value_name = "FILE")]
        shadow: Option<PathBuf>,
        /// Serve metrics for Prometheus at http://ADDRESS/metrics. Use a loopback address: every client may read them
        #[arg(long, value_name = "ADDRESS")]
        metrics: Option<SocketAddr>,
    },
    /// Check a configuration, and list what it would let out of the domain
    Check {
        /// The configuration
        #[arg(value_name = "FILE")]
        config: PathBuf,
        /// List what the rules of this configuration would change
        #[arg(long, value_name = "FILE")]
        shadow: Option<PathBuf>,
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
    /// Runs the command line of the program with this name. Its log goes to the standard error output, with the levels
    /// of `SM2_LOG`.
    pub fn main(self, name: &str) -> ExitCode {
        let arguments = Arguments::parse();
        let levels = match sm2_io::log_levels("info") {
            Ok(levels) => levels,
            Err(wrong) => {
                eprintln!("{name}: {wrong}");
                return ExitCode::from(WRONG_USAGE);
            }
        };
        tracing_subscriber::fmt()
            .with_env_filter(levels)
            .with_writer(io::stderr)
            .with_ansi(io::stderr().is_terminal())
            .init();
        match self.execute(arguments.command) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("{name}: {error}");
                ExitCode::FAILURE
            }
        }
    }

    fn execute(self, command: Command) -> Result<(), Box<dyn Error>> {
        match command {
            Command::Run {
                config,
                shadow,
                metrics,
            } => self.carry(&config, shadow.as_deref(), metrics)?,
            Command::Check { config, shadow } => self.check(&config, shadow.as_deref())?,
            Command::Explain {
                config,
                name,
                service,
            } => {
                let config = (self.load)(&config)?;
                let name = Name::typed(&name).map_err(|error| format!("wrong name: {error}"))?;
                explain((self.parts)(&config).1, &name, service);
            }
        }
        Ok(())
    }

    fn carry(
        self,
        config: &Path,
        shadow: Option<&Path>,
        metrics: Option<SocketAddr>,
    ) -> Result<(), Box<dyn Error>> {
        let config = (self.load)(config)?;
        let shadow = shadow.map(self.load).transpose()?;
        // Other programs decide how many topics, links and connections there are.
        sm2_io::raise_descriptor_limit();
        let shutdown = Shutdown::new()?;
        let mut bridge = (self.start)(&config)?;
        if let Some(shadow) = shadow {
            let rules = (self.parts)(&shadow).1;
            (self.set_shadow)(&mut bridge, Shadow::new(rules.clone()));
        }
        let account = (self.account)(&bridge);
        let read = account.clone();
        let serve = |address| {
            let server = Server::start(address, move || read().metrics());
            server.map_err(|error| format!("cannot serve metrics at {address}: {error}"))
        };
        let server = metrics.map(serve).transpose()?;
        if let Some(server) = &server {
            eprintln!("metrics are at http://{}/metrics", server.address());
        }
        eprintln!("the bridge carries messages");
        end_with_signals(&shutdown)?;
        (self.run)(&mut bridge, &shutdown)?;
        // Its end sends what waits for the network.
        drop(bridge);
        println!("{}", account());
        Ok(())
    }

    fn check(self, file: &Path, shadow: Option<&Path>) -> Result<(), Box<dyn Error>> {
        let config = (self.load)(file)?;
        let shadow = shadow.map(self.load).transpose()?;
        let (location, rules) = (self.parts)(&config);
        println!("{}: {} rules", file.display(), rules.notes.len());
        let node = location.connect(&format!("bridge-check-{}", std::process::id()));
        let node = match node {
            Ok(node) => node,
            // The file may be checked on a machine without the domain.
            Err(error) => {
                println!("cannot list what it would carry: {error}");
                return Ok(());
            }
        };
        let domain = node.snapshot()?;
        let shadow = shadow.as_ref().map(|it| (self.parts)(it).1);
        report(rules, shadow, &domain);
        Ok(())
    }
}

/// Prints what the rules let out of a domain, and what other rules would change.
fn report(rules: &RuleTables, shadow: Option<&RuleTables>, domain: &Domain) {
    for line in lets_out(rules, domain) {
        println!("{line}");
    }
    let Some(other) = shadow else {
        return;
    };
    let mut shadow = Shadow::new(other.clone());
    shadow.follow(domain);
    let lines = shadow.compare(rules);
    if lines.is_empty() {
        println!("shadow: no change for what the domain has now");
    }
    for line in lines {
        println!("shadow: {line}");
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
