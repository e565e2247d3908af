//! The processes that are measured. Each says `ready`, and follows the lines `begin` and `end` of standard
//! input; it answers `end` with its figures.

use std::{
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use sm2_node::{Node, Publisher, Subscriber};
use sm2_tests::{TIMEOUT, input::Input, options::Options, pattern};

/// The topic of publisher and subscriber, which attackers use, too.
pub(crate) const TOPIC: &str = "victim";
/// The topic that the newcomer subscribes to.
const BEACON: &str = "beacon";
const PUBLISHER: &str = "victim-publisher";
const PERIOD: Duration = Duration::from_millis(5);
const BYTES: usize = 10_000;
/// The wait for reliable subscribers: less than a period.
const PATIENCE: Duration = Duration::from_millis(2);
/// The time between two new subscribers.
const PAUSE: Duration = Duration::from_millis(20);

/// Runs a role until standard input ends.
pub(crate) fn run(role: &str, options: &Options) -> ExitCode {
    let socket: String = options.get("--socket").expect("--socket");
    let name = format!("victim-{role}");
    let node = Node::builder(&name).socket(socket).manager_timeout(TIMEOUT);
    let node = node.connect().expect("a session");
    match role {
        "publisher" => publish(&node),
        "subscriber" => subscribe(&node),
        "newcomer" => join(&node),
        other => panic!("no role {other:?}"),
    }
}

fn publish(node: &Node) -> ExitCode {
    let mut input = Input::new();
    let builder = node.publisher_builder::<[u8]>(TOPIC).reliable(true);
    let publisher = builder.publish_timeout(PATIENCE).declare();
    let publisher: Publisher<[u8]> = publisher.expect("a publisher");
    let _beacon: Publisher<[u8]> = node.publisher(BEACON).expect("a publisher");
    println!("ready");
    let mut due = Instant::now();
    for number in 1.. {
        loop {
            let wait = due.saturating_duration_since(Instant::now());
            if wait.is_zero() {
                break;
            }
            node.spin_once_timeout(wait).expect("the node's own wait");
        }
        due = (due + PERIOD).max(Instant::now());
        if input.lines().is_err() {
            break;
        }
        // A publisher that has no memory left for a message goes on with the next one.
        if let Ok(mut message) = publisher.loan_slice(BYTES) {
            pattern::fill(&mut message, number);
            let _ = message.publish();
        }
    }
    ExitCode::SUCCESS
}

/// The figures of a subscriber's window.
#[derive(Default)]
struct Taken {
    delays_us: Vec<u64>,
    lost: u64,
    damaged: u64,
}

fn subscribe(node: &Node) -> ExitCode {
    let mut input = Input::new();
    let subscriber: Subscriber<[u8]> = node.subscriber(TOPIC).expect("a subscriber");
    subscriber.recv_timeout(TIMEOUT).expect("received");
    println!("ready");
    let (mut taken, mut since) = (Taken::default(), Instant::now());
    loop {
        // Attackers publish to the topic, too: messages that cannot be mapped are theirs.
        if let Ok(Some(sample)) = subscriber.recv_timeout(Duration::from_millis(10))
            && sample.publisher().as_str() == PUBLISHER
        {
            let delay = sm2_node::now().0.saturating_sub(sample.source_time().0);
            taken.delays_us.push(delay / 1_000);
            taken.lost += sample.lost();
            taken.damaged += u64::from(!pattern::is_intact(&sample, sample.sequence()));
        }
        let Ok(lines) = input.lines() else {
            return ExitCode::SUCCESS;
        };
        for line in lines {
            if line == "end" {
                let hz = taken.delays_us.len() as f64 / since.elapsed().as_secs_f64();
                println!(
                    "hz={hz:.0} p99_us={} lost={} damaged={}",
                    p99(&mut taken.delays_us),
                    taken.lost,
                    taken.damaged
                );
            }
            (taken, since) = (Taken::default(), Instant::now());
        }
    }
}

fn join(node: &Node) -> ExitCode {
    let mut input = Input::new();
    println!("ready");
    let mut times_us = Vec::new();
    loop {
        let start = Instant::now();
        let subscriber = node.subscriber::<[u8]>(BEACON);
        // A Manager that has no room or no time for it is what is measured.
        if let Ok(subscriber) = subscriber {
            while !subscriber.links().iter().any(|it| it.open) && start.elapsed() < TIMEOUT {
                let wait = Duration::from_millis(1);
                node.spin_once_timeout(wait).expect("the node's own wait");
            }
        }
        let elapsed_us = start.elapsed().as_micros() as u64;
        let Ok(lines) = input.lines() else {
            return ExitCode::SUCCESS;
        };
        // An attempt belongs to the window where it ends, and to one that it outlasts.
        if lines.iter().any(|it| it == "begin") {
            times_us.clear();
        }
        times_us.push(elapsed_us);
        if lines.iter().any(|it| it == "end") {
            println!("p99_us={}", p99(&mut times_us));
        }
        thread::sleep(PAUSE);
    }
}

/// The 99th percentile, or 0 of nothing.
fn p99(values: &mut [u64]) -> u64 {
    values.sort_unstable();
    let index = (values.len() * 99).div_ceil(100).saturating_sub(1);
    values.get(index).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::p99;

    #[test]
    fn the_percentile_is_the_nearest_rank() {
        assert_eq!(p99(&mut []), 0);
        assert_eq!(p99(&mut [7]), 7);
        let mut hundred: Vec<u64> = (1..=100).rev().collect();
        assert_eq!(p99(&mut hundred), 99);
    }
}
