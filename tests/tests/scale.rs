//! Many nodes with 10 interfaces each: all register, all links open, and each link carries a
//! message.

use sm2_proto::control::Item;
use sm2_tests::{
    domain::TempDomain,
    process::{Process, actor},
};

/// How many nodes there are.
const NODES: usize = if cfg!(feature = "slow") { 500 } else { 50 };
/// How many processes share them.
const PROCESSES: usize = if cfg!(feature = "slow") { 10 } else { 5 };

#[test]
fn many_nodes_register_and_link() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let observer = manager.node("observer");
    observer.nodes();
    let baseline = manager.census_when_idle();
    let each = NODES / PROCESSES;
    let mut crowds: Vec<Process> = (0..PROCESSES)
        .map(|process| {
            let mut command = actor("crowd");
            command.arg("--socket").arg(domain.socket());
            let numbers = [process * each, each, NODES].map(|number| number.to_string());
            command.args(["--first", &numbers[0], "--count", &numbers[1]]);
            command.args(["--total", &numbers[2]]);
            Process::start(command)
        })
        .collect();
    let start = std::time::Instant::now();
    for word in ["declared", "linked", "passed"] {
        for crowd in &crowds {
            assert_eq!(crowd.expect_line(), word);
        }
        println!("{word} after {:?}", start.elapsed());
        if word == "linked" {
            // The observer, each node and each of its 10 interfaces.
            assert_eq!(everything(&observer), (1 + NODES, 10 * NODES, 10 * NODES));
        }
        crowds.iter_mut().for_each(|crowd| crowd.say("on"));
    }
    drop(crowds);
    baseline.restored(manager.pid());
    assert_eq!(observer.nodes(), ["observer"]);
}

/// The numbers of nodes, interfaces and ends of links in the domain, summed over all pages.
fn everything(observer: &sm2_tests::raw::RawNode) -> (usize, usize, usize) {
    let (mut nodes, mut interfaces, mut ends) = (0, 0, 0);
    for item in observer.query_all() {
        match item {
            Item::Node { .. } => nodes += 1,
            Item::Interface { .. } => interfaces += 1,
            Item::Link { .. } => ends += 2,
            _ => {}
        }
    }
    (nodes, interfaces, ends)
}
