//! The loop of a run: every peer runs every case in every repeat.

use std::{
    env,
    time::{Instant, SystemTime, UNIX_EPOCH},
};

use crate::{
    cli::RunArguments,
    interrupt,
    machine::Machine,
    peers::{PEERS, PeerInfo},
    results::{PeerFailure, Results, Skipped, join},
    workloads::{Case, Options},
    world,
};

/// Runs a workload. A failure of one peer is recorded, and the others continue.
#[must_use]
pub fn run(arguments: &RunArguments) -> Results {
    world::place(arguments.cores);
    let options = Options {
        read: arguments.read,
        seconds: arguments.seconds,
        size: arguments.size,
        nodes: arguments.nodes.map(usize::from),
        pauses: arguments.pauses,
        folder: arguments.folder.clone(),
        gigabytes: arguments.gigabytes,
        frame_rate: arguments.frame_rate,
    };
    let began = SystemTime::now().duration_since(UNIX_EPOCH);
    let mut results = Results {
        workload: arguments.workload.name.to_owned(),
        read: arguments.read,
        command: command(),
        began: began.map_or(0, |since| since.as_secs()),
        repeats: arguments.repeats,
        machine: Machine::here(),
        figures: Vec::new(),
        failures: Vec::new(),
        skipped: Vec::new(),
    };
    let peers = choose(arguments, &mut results);
    let cases = (arguments.workload.cases)(&options);
    for repeat in 1..=arguments.repeats {
        for case in &cases {
            // Peers alternate within each case, so that disturbances of the machine affect all of
            // them alike; each repeat starts with another peer.
            for index in 0..peers.len() {
                if interrupt::came() {
                    results.conclude();
                    return results;
                }
                let peer = peers[(index + repeat as usize - 1) % peers.len()];
                play(&mut results, case.as_ref(), peer, repeat);
            }
        }
    }
    results.conclude();
    results
}

/// The command line, with the program's name alone.
fn command() -> String {
    let words: Vec<_> = env::args().skip(1).collect();
    format!("sm2-bench {}", words.join(" "))
}

/// The chosen peers that can run the workload here.
fn choose(arguments: &RunArguments, results: &mut Results) -> Vec<&'static PeerInfo> {
    let all: Vec<_> = match &arguments.peers[..] {
        [] => PEERS.iter().collect(),
        chosen => chosen.to_vec(),
    };
    let mut peers = Vec::new();
    let possible = (arguments.workload.available)();
    for peer in all {
        let supported = (arguments.workload.supports)(peer).map_err(str::to_owned);
        let available = || possible.clone().and_then(|()| peer.available());
        match supported.and_then(|()| available()) {
            Ok(()) => peers.push(peer),
            Err(reason) => {
                eprintln!("{} is skipped: {reason}", peer.name);
                results.skipped.push(Skipped {
                    peer: peer.name.to_owned(),
                    reason,
                });
            }
        }
    }
    peers
}

fn play(results: &mut Results, case: &dyn Case, peer: &'static PeerInfo, repeat: u32) {
    let label = case.label();
    let name = join(&label, peer.name);
    let start = Instant::now();
    eprint!("{repeat}/{} {} {name} ", results.repeats, results.workload);
    match case.run(peer) {
        Ok(figures) => {
            let seconds = start.elapsed().as_secs_f64();
            let main = figures.first().map(|main| {
                let value = crate::format::number(main.value);
                format!("{} {value} {}", main.name, main.unit)
            });
            eprintln!("{} ({seconds:.1} s)", main.unwrap_or_default());
            for figure in figures {
                let name = join(&label, figure.name);
                results.record(peer.name, &name, figure.unit, figure.value);
            }
        }
        Err(_) if interrupt::came() => eprintln!("interrupted"),
        Err(failure) => {
            eprintln!("FAILED: {failure}");
            results.failures.push(PeerFailure {
                peer: peer.name.to_owned(),
                workload: results.workload.clone(),
                case: label,
                repeat,
                failed: failure.to_string(),
            });
        }
    }
}
