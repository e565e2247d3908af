//! The bridge beside a forwarder that was written by hand: a subscriber of SM2 that puts each message into Zenoh.
//!
//! `cargo bench --bench forwarder` prints, for messages of 1 MB, the CPU of each at 100 Hz and the highest rate of
//! each: medians of five runs in turn, and the ratio of the bridge to the forwarder.

mod common;

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use std::{env, fs};

use common::{MESSAGE_BYTES, Result, Running, bridge, free_endpoint, median, session};
use sm2_node::{Node, Rate};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::qos::CongestionControl;

const RUNS: usize = 5;
const TIME: Duration = Duration::from_secs(4);
/// The rates of the publisher: that of a fast camera, and more than a forwarder can carry.
const RATES_HZ: [u32; 2] = [100, 4_000];
const KINDS: [&str; 2] = ["forwarder", "bridge"];

fn main() -> Result<()> {
    let arguments: Vec<String> = env::args().collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [_, "bridge", folder, endpoint] => bridge(folder.as_ref(), endpoint),
        [_, "forwarder", folder, endpoint] => forwarder(folder.as_ref(), endpoint),
        _ => compare(),
    }
}

fn forwarder(folder: &Path, endpoint: &str) -> Result<()> {
    let node = Node::builder("forwarder")
        .socket(folder.join("sock"))
        .connect()?;
    let session = session("client", "connect", endpoint)?;
    let publisher = session.declare_publisher("bench/image");
    let publisher = publisher
        .congestion_control(CongestionControl::Drop)
        .wait()?;
    let subscriber = node
        .subscriber_builder::<[u8]>("image")
        .depth(64)
        .declare()?;
    loop {
        let sample = subscriber.recv()?;
        publisher.put(ZBytes::from(sample.to_vec())).wait()?;
    }
}

/// The CPU and the rate of one run.
struct Run {
    cores: f64,
    rate_hz: f64,
}

fn compare() -> Result<()> {
    println!("| messages | program | received, Hz | cores |");
    println!("| --- | --- | --- | --- |");
    for rate in RATES_HZ {
        let mut runs = KINDS.map(|_| Vec::new());
        for _ in 0..RUNS {
            for (kind, runs) in KINDS.iter().zip(&mut runs) {
                runs.push(run(kind, rate)?);
            }
        }
        let medians = runs.each_ref().map(|runs| {
            let of = |value: fn(&Run) -> f64| median(runs.iter().map(value).collect());
            (of(|it| it.rate_hz), of(|it| it.cores))
        });
        for (kind, (rate_hz, cores)) in KINDS.iter().zip(medians) {
            println!("| 1 MB at {rate} Hz | {kind} | {rate_hz:.0} | {cores:.3} |");
        }
        let [by_hand, bridge] = medians;
        let ratios = (bridge.0 / by_hand.0, bridge.1 / by_hand.1);
        println!(
            "| 1 MB at {rate} Hz | ratio | {:.3} | {:.3} |",
            ratios.0, ratios.1
        );
    }
    Ok(())
}

fn run(kind: &str, rate: u32) -> Result<Run> {
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("sock");
    let _manager = sm2_manager::Background::start(&socket, sm2_manager::Options::default())?;
    let endpoint = free_endpoint()?;
    let router = session("router", "listen", &endpoint)?;
    let received = Arc::new(Mutex::new(0_u64));
    let count = Arc::clone(&received);
    let subscriber = router.declare_subscriber("bench/image");
    let _subscriber = subscriber
        .callback(move |_| *count.lock().unwrap() += 1)
        .wait()?;
    let program = Running::start(kind, folder.path(), &endpoint)?;

    let camera = Node::builder("camera").socket(&socket).connect()?;
    let publisher = camera.publisher::<[u8]>("image")?;
    publisher.wait_for_subscribers_timeout(1, Duration::from_secs(20))?;
    let message = vec![7; MESSAGE_BYTES];
    let mut pace = Rate::hz(rate);
    let mut publish = |time| -> Result<()> {
        let end = Instant::now() + time;
        while Instant::now() < end {
            publisher.publish(&message)?;
            pace.sleep();
        }
        Ok(())
    };
    publish(Duration::from_millis(500))?;
    let before = (
        *received.lock().unwrap(),
        cpu(program.id())?,
        Instant::now(),
    );
    publish(TIME)?;
    let seconds = before.2.elapsed().as_secs_f64();
    let (count, cpu) = (
        *received.lock().unwrap() - before.0,
        cpu(program.id())? - before.1,
    );
    Ok(Run {
        cores: cpu.as_secs_f64() / seconds,
        rate_hz: count as f64 / seconds,
    })
}

/// The time that a process has run, in all its threads.
fn cpu(pid: u32) -> Result<Duration> {
    let mut total = Duration::ZERO;
    for task in fs::read_dir(format!("/proc/{pid}/task"))? {
        let text = fs::read_to_string(task?.path().join("schedstat"))?;
        let run = text.split(' ').next().ok_or("no time")?;
        total += Duration::from_nanos(run.parse()?);
    }
    Ok(total)
}
