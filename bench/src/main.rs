//! `sm2-bench`: runs one workload on SM2 and its peers in turn, with real processes, and reports the
//! figures.
//!
//! | module | content |
//! | --- | --- |
//! | `cli`, `run`, `report`, `plot` | the director's command line, loop and output |
//! | `workloads/` | the workloads, one file for each |
//! | `world` | the processes of one case |
//! | `disk`, `recorded` | the folder of recorded files, and their content |
//! | `link/` | a bad link between two hosts on this machine |
//! | `roles/` | the loops of the processes, the same for every peer |
//! | `peers/` | the peers, one file for each |
//! | `payload`, `stats`, `measure`, `clock` | messages, statistics and measurements |

use std::{error::Error, io::Write, process::ExitCode};

use clap::Parser;

use cli::{Cli, Command, ReportArguments, RunArguments};
use results::Results;

mod cli;
mod clock;
mod control;
mod disk;
mod format;
mod interrupt;
mod job;
mod leftovers;
mod link;
mod machine;
mod measure;
mod payload;
mod peers;
mod plot;
mod recorded;
mod report;
mod results;
mod roles;
mod run;
mod stats;
mod workloads;
mod world;

fn main() -> ExitCode {
    let done = match Cli::parse().command {
        Command::Role { job } => return roles::run(&job),
        Command::Run(arguments) => run(&arguments),
        Command::Report(arguments) => report(&arguments),
        Command::List => list().map_err(Into::into),
    };
    match done {
        Ok(()) if interrupt::came() => ExitCode::from(130),
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sm2-bench: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &RunArguments) -> Result<(), Box<dyn Error>> {
    interrupt::watch()?;
    let results = run::run(arguments);
    let path = results.save(&arguments.out)?;
    eprintln!("results: {}", path.display());
    for plot in plot::draw(&results, &arguments.out.join("plots"))? {
        eprintln!("plot: {}", plot.display());
    }
    if let Some(file) = &arguments.markdown {
        report::rewrite(file, &Results::load_all(&arguments.out)?)?;
        eprintln!("tables: {}", file.display());
    }
    let text = match arguments.json {
        true => report::json_lines(&results)?,
        false => report::table(&results),
    };
    std::io::stdout().write_all(text.as_bytes())?;
    match results.figures.is_empty() {
        true => Err("no peer has produced a figure".into()),
        false => Ok(()),
    }
}

fn report(arguments: &ReportArguments) -> Result<(), Box<dyn Error>> {
    let all = Results::load_all(&arguments.dir)
        .map_err(|error| format!("cannot read {}: {error}", arguments.dir.display()))?;
    for results in &all {
        plot::draw(results, &arguments.dir.join("plots"))?;
    }
    match &arguments.markdown {
        Some(file) => report::rewrite(file, &all)?,
        None => std::io::stdout().write_all(report::markdown(&all).as_bytes())?,
    }
    Ok(())
}

/// Prints the workloads and peers, and the reason for each that cannot run here.
fn list() -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "workloads:")?;
    for workload in workloads::WORKLOADS {
        writeln!(out, "  {:12} {}", workload.name, workload.about)?;
        if let Err(reason) = (workload.available)() {
            writeln!(out, "  {:12} cannot run here: {reason}", "")?;
        }
    }
    writeln!(out, "peers:")?;
    for peer in peers::PEERS {
        writeln!(out, "  {:24} {}", peer.name, peer.about)?;
        if let Err(reason) = peer.available() {
            writeln!(out, "  {:24} cannot run here: {reason}", "")?;
            continue;
        }
        let missing = workloads::WORKLOADS.iter().filter_map(|workload| {
            let reason = (workload.supports)(peer).err()?;
            Some(format!("{} ({reason})", workload.name))
        });
        let missing: Vec<_> = missing.collect();
        if !missing.is_empty() {
            writeln!(out, "  {:24} not in {}", "", missing.join(", "))?;
        }
    }
    Ok(())
}
