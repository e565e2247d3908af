//! A local subscriber while the network behind a bridge is stalled.
//!
//! `cargo bench --bench stalled` prints the 99th percentile of the latency of messages of 1 MB at 100 Hz between two
//! nodes of a domain: without a bridge, and with one whose router was stopped (`SIGSTOP`). Five runs of each, in turn.

mod common;

use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use common::{MESSAGE_BYTES, Result, Running, bridge, free_endpoint, median, session};
use sm2_node::{Node, Publisher, Rate, Subscriber, now};
use zenoh::Wait;

const RUNS: usize = 5;
const TIME: Duration = Duration::from_secs(5);
const RATE_HZ: u32 = 100;

fn main() -> Result<()> {
    let arguments: Vec<String> = env::args().collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [_, "bridge", folder, endpoint] => bridge(folder.as_ref(), endpoint),
        [_, "router", folder, endpoint] => router(folder.as_ref(), endpoint),
        _ => compare(),
    }
}

/// Receives all messages of the bridge, until it is stopped.
fn router(_: &Path, endpoint: &str) -> Result<()> {
    let session = session("router", "listen", endpoint)?;
    let _subscriber = session.declare_subscriber("**").callback(drop).wait()?;
    loop {
        thread::park();
    }
}

fn compare() -> Result<()> {
    let (mut alone, mut stalled, mut memory) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..RUNS {
        alone.push(run(false)?.0);
        let (p99_us, peak) = run(true)?;
        stalled.push(p99_us);
        memory.push(peak);
    }
    println!("| domain | 99th percentile, us (median, least and most of {RUNS}) |");
    println!("| --- | --- |");
    for (name, values) in [("alone", &alone), ("with a stalled bridge", &stalled)] {
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let most = values.iter().copied().fold(0.0, f64::max);
        println!(
            "| {name} | {:.0} ({least:.0}-{most:.0}) |",
            median(values.clone())
        );
    }
    println!("peak memory of the bridge (VmHWM): {}", memory.join(", "));
    Ok(())
}

/// The 99th percentile in microseconds, and the peak memory of the bridge if there is one.
fn run(is_stalled: bool) -> Result<(f64, String)> {
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("sock");
    let _manager = sm2_manager::Background::start(&socket, sm2_manager::Options::default())?;
    let camera = Node::builder("camera").socket(&socket).connect()?;
    let viewer = Node::builder("viewer").socket(&socket).connect()?;
    let publisher = camera.publisher::<[u8]>("image")?;
    let subscriber = viewer.subscriber::<[u8]>("image")?;
    let endpoint = free_endpoint()?;
    let mut processes = Vec::new();
    if is_stalled {
        for role in ["router", "bridge"] {
            processes.push(Running::start(role, folder.path(), &endpoint)?);
            // A client does not wait for its router.
            let address = endpoint.trim_start_matches("tcp/");
            while TcpStream::connect(address).is_err() {
                thread::sleep(Duration::from_millis(10));
            }
        }
    }
    let links = 1 + usize::from(is_stalled);
    publisher.wait_for_subscribers_timeout(links, Duration::from_secs(20))?;
    let receiver = thread::spawn(move || receive(&subscriber));
    publish(&publisher, Duration::from_secs(1))?;
    if let [router, _] = &processes[..] {
        let stop = ["-STOP", &router.id().to_string()];
        assert!(Command::new("kill").args(stop).status()?.success());
    }
    publish(&publisher, TIME)?;
    drop(publisher);
    let latencies = receiver.join().map_err(|_| "the receiver panicked")??;
    // Those of the time before the router was stopped are left out.
    let mut latencies = latencies[latencies.len() / 6..].to_vec();
    latencies.sort_by(f64::total_cmp);
    let p99_us = latencies[latencies.len() * 99 / 100];
    let peak = processes.get(1).map(|bridge| peak_memory(bridge.id()));
    Ok((p99_us, peak.transpose()?.unwrap_or_default()))
}

fn publish(publisher: &Publisher<[u8]>, time: Duration) -> Result<()> {
    let message = vec![7; MESSAGE_BYTES];
    let mut pace = Rate::hz(RATE_HZ);
    let begin = Instant::now();
    while begin.elapsed() < time {
        publisher.publish(&message)?;
        pace.sleep();
    }
    Ok(())
}

/// Receives until the publisher is gone. Returns the latencies in microseconds.
fn receive(subscriber: &Subscriber<[u8]>) -> Result<Vec<f64>> {
    let mut latencies = Vec::new();
    while let Some(sample) = subscriber.recv_timeout(Duration::from_millis(500))? {
        let latency = now().since(sample.source_time());
        latencies.push(latency.as_secs_f64() * 1e6);
    }
    Ok(latencies)
}

/// The line `VmHWM` of `/proc/PID/status`.
fn peak_memory(pid: u32) -> Result<String> {
    let text = fs::read_to_string(format!("/proc/{pid}/status"))?;
    let found = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    Ok(found.ok_or("no such line")?.trim().to_owned())
}
