//! The nodes of the run. Each is a process that follows the lines of standard input:
//!
//! | line | action | answer |
//! | --- | --- | --- |
//! | | connects | `connected` |
//! | `go` | declares its interfaces, or sends again | |
//! | `rest` | sends no more | `resting`, when each message that it sent is settled |
//! | `links` | | `links`, and an end of the ledger for each open link |
//! | `close` | withdraws its interfaces | `closed` |
//!
//! With `--go true` it does not wait for the first `go`. It says `tally …` four times a second, and
//! `wrong …` for everything that must not happen.

mod churn;
mod late;
mod publisher;
mod service;
mod subscriber;
mod work;

use std::{
    process::ExitCode,
    time::{Duration, Instant},
};

use sm2_node::{Node, diagnostics::LinkStatus};
use sm2_tests::{TIMEOUT, input::Input, options::Options};

use self::work::{Work, connect};
use crate::{
    ledger::{End, unbalanced},
    tally::Tally,
};

/// How often a process reports its tally.
const TALLY: Duration = Duration::from_millis(250);

/// Carries out the commands of the run, until standard input ends.
pub(crate) fn run(role: &str, options: &Options) -> ExitCode {
    let mut input = Input::new();
    let name: String = options.get("--name").expect("--name");
    let socket: String = options.get("--socket").expect("--socket");
    let node = connect(&name, &socket);
    println!("connected");
    if !options.get_or("--go", false) {
        while !lines(&mut input).iter().any(|it| it == "go") {
            drive(&node);
        }
    }
    let mut work: Option<Box<dyn Work>> = Some(match role {
        "publisher" => Box::new(publisher::Publishing::new(&node, options)),
        "subscriber" => Box::new(subscriber::Subscribing::new(&node, options)),
        "late" => Box::new(late::Late::new(&node, options)),
        "server" => Box::new(service::Serving::new(&node, options)),
        "client" => Box::new(service::Calling::new(&node, options)),
        "churn" => Box::new(churn::Churn::new(&name, &socket)),
        other => panic!("no role {other:?}"),
    });
    let mut tally = Tally::default();
    let mut due = Instant::now();
    // The latest moment for everything to be settled.
    let mut resting: Option<Instant> = None;
    loop {
        for line in lines(&mut input) {
            match (line.as_str(), &mut work) {
                ("go" | "rest", Some(work)) => {
                    resting = (line == "rest").then(|| Instant::now() + TIMEOUT / 2);
                    work.set_resting(resting.is_some());
                }
                ("links", Some(work)) => println!("links {}", ends(&work.links())),
                ("close", work) => {
                    *work = None;
                    println!("closed");
                }
                other => panic!("no command {other:?}", other = other.0),
            }
        }
        let Some(work) = &mut work else {
            drive(&node);
            continue;
        };
        work.turn(&mut tally);
        if let Some(late) = resting {
            if work.is_settled() {
                resting = None;
                println!("resting");
            } else if late < Instant::now() {
                resting = Some(late + TIMEOUT);
                let unsettled = work.links().into_iter();
                let unsettled = unsettled.filter(|it| it.end.is_none());
                unsettled.for_each(|it| println!("wrong not settled: {it:?}"));
            }
        }
        if due <= Instant::now() {
            due = Instant::now() + TALLY;
            audit(&work.links(), &mut tally);
            tally.print();
        }
    }
}

fn ends(links: &[LinkStatus]) -> String {
    let open = links.iter().filter(|it| it.open && it.end.is_none());
    let all: Vec<String> = open.map(End::text).collect();
    all.join(" ")
}

/// Checks the sender's equation of each link (SM2-QOS-006).
fn audit(links: &[LinkStatus], tally: &mut Tally) {
    for link in links {
        let missing = unbalanced(&link.counters);
        if missing > 0 {
            tally.unaccounted(missing, &format!("{link:?}"));
        }
    }
}

/// The lines that have arrived. The process ends with its input.
fn lines(input: &mut Input) -> Vec<String> {
    input.lines().unwrap_or_else(|_| std::process::exit(0))
}

/// Drives a node that has nothing else to do.
fn drive(node: &Node) {
    let driven = node.spin_once_timeout(Duration::from_millis(5));
    driven.expect("the node's own wait");
}
