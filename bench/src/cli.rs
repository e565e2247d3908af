//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use crate::{
    job::{Cores, ROLE_COMMAND, Read},
    payload::HEADER_BYTES,
    peers::{self, PeerInfo},
    workloads::{self, Workload},
};

/// SM2 beside other middlewares, in one run.
#[derive(Debug, Parser)]
#[command(name = "sm2-bench", version, about)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a workload on all peers in turn
    Run(RunArguments),
    /// Say which workloads and peers can run here
    List,
    /// Write the tables and plots anew from the results of earlier runs
    Report(ReportArguments),
    /// A process of a run.
    #[command(name = ROLE_COMMAND, hide = true)]
    Role {
        /// What it does, as JSON.
        job: String,
    },
}

/// What to run, and how.
#[derive(Debug, Args)]
pub struct RunArguments {
    /// Which workload: see `list`
    #[arg(value_parser = workload)]
    pub workload: &'static Workload,
    /// What subscribers do with a message
    #[arg(long, value_enum, default_value_t)]
    pub read: Read,
    /// Which peers, separated by commas; all that can run here if it is not said
    #[arg(long, value_delimiter = ',', value_parser = peer)]
    pub peers: Vec<&'static PeerInfo>,
    /// How often all is run; every peer has its turn in each repeat
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub repeats: u32,
    /// How long each case counts, in seconds; the workload's own choice if it is not said
    #[arg(long, value_parser = positive)]
    pub seconds: Option<f64>,
    /// The length of large messages, in bytes
    #[arg(long, default_value_t = 10_000_000, value_parser = message_length)]
    pub size: usize,
    /// On which cores processes run; daemons always run where the scheduler wants them
    #[arg(long, value_enum, default_value_t)]
    pub cores: Cores,
    /// How many nodes join in `nodes`; 50, then 100, if it is not said
    #[arg(long, value_parser = clap::value_parser!(u16).range(2..))]
    pub nodes: Option<u16>,
    /// In `bad-link`: one more case, in which the link stands still for 102 ms and 1,030 ms at times
    #[arg(long)]
    pub pauses: bool,
    /// Print one JSON object per peer and figure on a line of its own, and no table
    #[arg(long)]
    pub json: bool,
    /// Where results and plots are kept
    #[arg(long, default_value = "results", value_name = "DIR")]
    pub out: PathBuf,
    /// Write the tables of all results in DIR into this file, between its two marker lines
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
}

/// From what to report, and where.
#[derive(Debug, Args)]
pub struct ReportArguments {
    /// Where results are kept
    pub dir: PathBuf,
    /// Write the tables into this file, between its two marker lines; print them if it is not said
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
}

fn workload(name: &str) -> Result<&'static Workload, String> {
    workloads::find(name).ok_or_else(|| {
        let names: Vec<_> = workloads::WORKLOADS.iter().map(|all| all.name).collect();
        format!("there are {}", names.join(", "))
    })
}

fn peer(name: &str) -> Result<&'static PeerInfo, String> {
    peers::catalogue::find(name).ok_or_else(|| {
        let names: Vec<_> = peers::PEERS.iter().map(|all| all.name).collect();
        format!("there are {}", names.join(", "))
    })
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.01..=3_600.0).contains(&seconds) => Ok(seconds),
        _ => Err("a number of seconds from 0.01 to 3600 is needed".to_owned()),
    }
}

fn message_length(text: &str) -> Result<usize, String> {
    match text.replace('_', "").parse() {
        Ok(bytes) if (HEADER_BYTES..=1 << 30).contains(&bytes) => Ok(bytes),
        _ => Err(format!(
            "a number of bytes from {HEADER_BYTES} to 2^30 is needed"
        )),
    }
}

#[cfg(test)]
mod tests;
