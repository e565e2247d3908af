//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use crate::{
    disk,
    job::{Cores, ROLE_COMMAND, Read},
    payload::HEADER_BYTES,
    peers::{self, PeerInfo},
    workloads::{self, Workload},
};

/// SM2 beside other middlewares, in one run.
#[derive(Debug, Parser)]
#[command(name = "sm2-bench", version, about)]
pub struct Cli {
    /// The subcommand.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a workload on all peers in turn
    Run(RunArguments),
    /// List the workloads and peers, and why some cannot run here
    List,
    /// Write the tables and plots of the results of earlier runs
    Report(ReportArguments),
    /// Run one process of a run.
    #[command(name = ROLE_COMMAND, hide = true)]
    Role {
        /// The job of the process, as JSON.
        job: String,
    },
}

/// The arguments of `run`.
#[derive(Debug, Args)]
pub struct RunArguments {
    /// Workload to run: see `list`
    #[arg(value_parser = workload)]
    pub workload: &'static Workload,
    /// Part of each message that subscribers read
    #[arg(long, value_enum, default_value_t)]
    pub read: Read,
    /// Peers to run, separated by commas [default: all that can run here]
    #[arg(long, value_delimiter = ',', value_parser = peer)]
    pub peers: Vec<&'static PeerInfo>,
    /// Number of repeats; every peer runs in each repeat
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub repeats: u32,
    /// Duration of the counted part of each case, in seconds [default: depends on the workload]
    #[arg(long, value_parser = positive)]
    pub seconds: Option<f64>,
    /// Length of large messages, in bytes
    #[arg(long, default_value_t = 10_000_000, value_parser = message_length)]
    pub size: usize,
    /// Assignment of processes to cores; the scheduler always places daemons
    #[arg(long, value_enum, default_value_t)]
    pub cores: Cores,
    /// Number of nodes in `nodes` [default: 50, then 100]
    #[arg(long, value_parser = clap::value_parser!(u16).range(2..))]
    pub nodes: Option<u16>,
    /// In `bad-link`, add a case where the link pauses at times, for 102 ms or 1,030 ms
    #[arg(long)]
    pub pauses: bool,
    /// In `record` and `seek`, the folder of the recorded files, on a disk [default: the system's folder for temporary
    /// files]
    #[arg(long, value_name = "DIR", value_parser = disk_folder)]
    pub folder: Option<PathBuf>,
    /// In `record` and `seek`, the amount of data of each recording, in GB; `record` needs twice the room [default: 4
    /// and 20]
    #[arg(long, value_name = "N", value_parser = gigabytes)]
    pub gigabytes: Option<f64>,
    /// In `record` and `seek`, publish this number of frames per second [default: as many as the recorder takes]
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub frame_rate: Option<f64>,
    /// Print one JSON object per peer and figure, one per line, instead of tables
    #[arg(long)]
    pub json: bool,
    /// Folder for results and plots
    #[arg(long, default_value = "results", value_name = "DIR")]
    pub out: PathBuf,
    /// Write the tables of all results in DIR into this file, between its two marker lines
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
}

/// The arguments of `report`.
#[derive(Debug, Args)]
pub struct ReportArguments {
    /// Folder with results
    pub dir: PathBuf,
    /// Write the tables into this file, between its two marker lines [default: print them]
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

fn disk_folder(text: &str) -> Result<PathBuf, String> {
    let folder = PathBuf::from(text);
    match disk::check(&folder) {
        Ok(()) => Ok(folder),
        Err(error) => Err(error.to_string()),
    }
}

fn gigabytes(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(gigabytes) if (0.01..=10_000.0).contains(&gigabytes) => Ok(gigabytes),
        _ => Err("a number of GB from 0.01 to 10000 is needed".to_owned()),
    }
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (0.01..=10_000.0).contains(&rate) => Ok(rate),
        _ => Err("a number of frames per second from 0.01 to 10000 is needed".to_owned()),
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
