//! Compares two publishers in two threads of one node with two publishers in two processes.
//!
//! `cargo run --release -p sm2-node --example two_threads`
//!
//! No subscriber is linked, so each publication is a call that the publisher's own lock covers. The rates are messages
//! of 64 bytes per second, of both publishers together: medians of nine rounds that alternate.

use std::error::Error;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use sm2_manager::{Background, Options};
use sm2_node::{Node, PublishError, Publisher};

const ROUNDS: usize = 9;
const SPAN: Duration = Duration::from_millis(500);
const PUBLISHERS: usize = 2;

type Done<T = ()> = Result<T, Box<dyn Error>>;

fn main() -> Done {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [] => compare(),
        ["publish", socket, name, threads] => {
            println!("{}", publish(Path::new(socket), name, threads.parse()?)?);
            Ok(())
        }
        _ => Err("no arguments are needed".into()),
    }
}

fn compare() -> Done {
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("domain.sock");
    let _manager = Background::start(&socket, Options::default())?;
    let (mut processes, mut threads) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        processes.push(rate(&socket, &[("first", 1), ("second", 1)])?);
        threads.push(rate(&socket, &[("both", PUBLISHERS)])?);
    }
    let (processes, threads) = (median(processes), median(threads));
    println!("two processes        {processes:>12.0} messages/s");
    println!("two threads, a node  {threads:>12.0} messages/s");
    println!("ratio                {:>12.2}", threads / processes);
    Ok(())
}

/// Runs processes with these names and numbers of publishers at the same time. Returns the sum of their rates.
fn rate(socket: &Path, nodes: &[(&str, usize)]) -> Done<f64> {
    let program = std::env::current_exe()?;
    let start = |(name, threads): &(&str, usize)| {
        let mut command = Command::new(&program);
        command.arg("publish").arg(socket).arg(name);
        command.arg(threads.to_string()).stdout(Stdio::piped());
        command.spawn()
    };
    let children: Vec<Child> = nodes.iter().map(start).collect::<Result<_, _>>()?;
    let mut sum = 0.0;
    for child in children {
        let output = child.wait_with_output()?;
        sum += String::from_utf8(output.stdout)?.trim().parse::<f64>()?;
    }
    Ok(sum)
}

/// Publishes from this many threads of one node. Returns the messages per second.
fn publish(socket: &Path, name: &str, threads: usize) -> Done<f64> {
    let node = Node::builder(name).socket(socket).connect()?;
    let declare = |index| node.publisher::<[u8]>(&format!("{name}/{index}"));
    let publishers: Vec<_> = (0..threads).map(declare).collect::<Result<_, _>>()?;
    let count = |publisher: &Publisher<[u8]>| {
        let (start, mut count) = (Instant::now(), 0_u64);
        while start.elapsed() < SPAN {
            for _ in 0..100 {
                publisher.publish(&[1; 64])?;
            }
            count += 100;
        }
        Ok::<u64, PublishError>(count)
    };
    let counts: Vec<_> = thread::scope(|scope| {
        let threads: Vec<_> = (publishers.iter())
            .map(|publisher| scope.spawn(move || count(publisher)))
            .collect();
        (threads.into_iter())
            .map(|thread| thread.join().expect("it does not panic"))
            .collect()
    });
    let counts = counts.into_iter().collect::<Result<Vec<_>, _>>()?;
    Ok(counts.iter().sum::<u64>() as f64 / SPAN.as_secs_f64())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
