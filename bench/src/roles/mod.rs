//! The roles of the processes of a run. Each role is one loop, the same for every peer.

use std::{fs::File, process::ExitCode};

use nix::{
    sched::{CloneFlags, CpuSet, sched_setaffinity, setns},
    sys::{prctl, signal::Signal},
    unistd::Pid,
};

use crate::{
    control::{self, send_event},
    job::{Job, Outcome, ProcessEvent, Role},
    with_peer,
};

mod disk;
mod failure;
mod memory;
mod node;
mod reception;
mod record;
mod round_trips;
mod seek;
mod service;
mod stream;
mod watch;

use failure::Failure;

/// Runs a job, given as JSON, and reports its outcome to the director.
#[must_use]
pub fn run(job: &str) -> ExitCode {
    // The kernel kills this process when the director ends, for whatever reason.
    let _ = prctl::set_pdeathsig(Signal::SIGKILL);
    match play(job) {
        // The role has reported its outcome itself, or has none.
        Ok(Outcome::Nothing) => ExitCode::SUCCESS,
        Ok(outcome) => {
            let sent = send_event(&ProcessEvent::Done(outcome));
            control::wait_for(control::Stage::End);
            match sent {
                Ok(()) => ExitCode::SUCCESS,
                Err(_) => ExitCode::FAILURE,
            }
        }
        Err(reason) => {
            let reason = reason.to_string();
            eprintln!("{reason}");
            // If the director is gone, the reason is on standard error.
            let _ = send_event(&ProcessEvent::Failed { reason });
            ExitCode::FAILURE
        }
    }
}

fn play(job: &str) -> Result<Outcome, Failure> {
    let Job {
        domain,
        role,
        core,
        network,
    } = serde_json::from_str(job)?;
    // Before the first thread starts: threads inherit the network namespace and the core.
    if let Some(network) = network {
        setns(File::open(network)?, CloneFlags::CLONE_NEWNET)?;
    }
    if let Some(core) = core {
        let mut cores = CpuSet::new();
        cores.set(core)?;
        sched_setaffinity(Pid::from_raw(0), &cores)?;
    }
    // These roles wait inside the peer, so that they cannot wait for the director's words.
    let leave = matches!(role, Role::Daemon | Role::Node { .. });
    control::listen(leave)?;
    with_peer!(domain, P => match role {
        Role::Daemon => node::daemon::<P>(&domain),
        Role::Publisher(stream) => stream::publish::<P>(&domain, &stream),
        Role::Subscriber { channel, read, number } => {
            stream::subscribe::<P>(&domain, &channel, read, number)
        }
        Role::Watcher { channel, read, number } => {
            watch::watch::<P>(&domain, &channel, read, number)
        }
        Role::Ping(trips) => round_trips::ping::<P>(&domain, &trips),
        Role::Echo(trips) => round_trips::echo::<P>(&domain, &trips),
        Role::Client(trips) => service::call::<P>(&domain, &trips),
        Role::Server(trips) => service::serve::<P>(&domain, &trips),
        Role::Node { number, count } => node::node::<P>(&domain, number, count),
        Role::Joiner { channel, started_ns } => node::join::<P>(&domain, &channel, started_ns),
        Role::Memory(work) => Ok(memory::work(&work)),
        Role::Frames(frames) => record::frames::<P>(&domain, &frames),
        Role::SmallTopics(topics) => record::small_topics::<P>(&domain, &topics),
        Role::Recorder(recording) => record::record::<P>(&domain, &recording),
        Role::DiskWriter(work) => disk::write(&work),
        Role::Seeker(seek) => seek::seek(&seek),
    })
}
