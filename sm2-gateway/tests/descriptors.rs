//! A process whose topics would take all descriptors of a gateway. `hub::shares` has the decisions alone.

use std::{
    fs,
    path::PathBuf,
    process::{Child, Command, Stdio},
    thread,
    time::Duration,
};

use sm2_gateway::{Report, report};
use sm2_node::{Node, Publisher, Subscriber};
use sm2_test_support::{SOON, ran_alone, until};

use crate::common::{ALL, Domain, Process, runtime};

/// The socket of the domain of [`an_honest_process`].
const SOCKET: &str = "SM2_GATEWAY_TEST_SOCKET";
/// The descriptors of the gateway, and the topics of the flood.
const SIZES: (u64, usize) = match cfg!(feature = "slow") {
    true => (1_024, 700),
    false => (192, 100),
};
/// The messages of the honest process that have to arrive.
const MESSAGES: u64 = 100;

/// A process that is killed when the test ends.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn publishers(node: &Node, count: usize) -> Vec<Publisher<u64>> {
    let topics = 0..count;
    let publisher = |it| node.publisher::<u64>(&format!("flood/{it}")).unwrap();
    topics.map(publisher).collect()
}

fn report(node: &Node) -> Option<Report> {
    let services = report::gateways(&node.snapshot().unwrap());
    let reports = report::ask(node, services, SOON);
    reports.into_iter().find_map(|(_, report)| report.ok())
}

fn is_linked(publisher: &Publisher<u64>) -> bool {
    publisher.links().iter().any(|it| it.open)
}

#[test]
fn a_flood_of_topics_leaves_descriptors_for_those_of_another_process() {
    const PATH: &str = concat!(
        module_path!(),
        "::a_flood_of_topics_leaves_descriptors_for_those_of_another_process"
    );
    if ran_alone(PATH) {
        return;
    }
    // Each topic is a link of this process, too.
    sm2_io::raise_descriptor_limit();
    let (limit, count) = SIZES;
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    near.config(&[(&far, None)], ALL);
    let (gateway, address) = Process::with_limits(&near.path("gateway.toml"), limit, limit);
    let runtime = runtime();
    let right = far.gateway(&runtime, &[(&near, Some(address))], ALL);
    let [flooding, listening] = [near.node("flooding"), far.node("listening")];
    let flood = publishers(&flooding, count);
    let subscriber =
        |it: &Publisher<u64>| listening.subscriber::<u64>(it.topic().as_str()).unwrap();
    let heard: Vec<Subscriber<u64>> = flood.iter().map(subscriber).collect();
    until("the flood has its share", || {
        let linked = flood.iter().filter(|it| is_linked(it)).count();
        let waiting = report(&flooding).map_or(0, |it| it.waiting.len());
        linked > 0 && linked + waiting >= count
    });
    let path = near.path("sock");
    let _honest = Killed(honest(path));
    let subscriber = listening.subscriber::<u64>("honest").unwrap();
    let (mut received, mut last) = (0, None);
    while received < MESSAGES {
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
        assert!(last < Some(*sample), "{last:?}, {}", *sample);
        last = Some(*sample);
        received += 1;
    }
    // The flood goes on with most of what it had.
    let linked = (0..count).filter(|it| is_linked(&flood[*it]));
    let linked: Vec<usize> = linked.collect();
    assert!(linked.len() as u64 > limit / 24, "{linked:?}");
    let one = linked[0];
    flood[one].publish(&7).unwrap();
    let sample = heard[one].recv_timeout(SOON).unwrap().expect("in time");
    assert_eq!(*sample, 7);
    let open = gateway.descriptors() as u64;
    println!(
        "{open} of {limit} descriptors, {} of {count} topics of the flood",
        linked.len()
    );
    assert!(open < limit);
    runtime.block_on(right.stop());
}

/// Starts a process that publishes a topic.
fn honest(socket: PathBuf) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    let name = "descriptors::an_honest_process";
    command.args(["--exact", name, "--ignored"]);
    command.env(SOCKET, socket).stdout(Stdio::null());
    command.spawn().unwrap()
}

#[test]
#[ignore = "runs in a child process of another test"]
fn an_honest_process() {
    let Some(socket) = std::env::var_os(SOCKET) else {
        return;
    };
    let node = Node::builder("honest").socket(socket).connect().unwrap();
    let publisher = node.publisher::<u64>("honest").unwrap();
    // Until it is killed.
    for number in 1.. {
        publisher.publish(&number).unwrap();
        thread::sleep(Duration::from_millis(10));
    }
}

/// The usual soft limit is raised to the hard one, so there is room for more topics.
#[test]
fn a_gateway_raises_its_soft_limit_of_descriptors() {
    let near = Domain::new("near");
    near.config(&[], ALL);
    let (gateway, _) = Process::with_limits(&near.path("gateway.toml"), 100, 300);
    let limits = fs::read_to_string(format!("/proc/{}/limits", gateway.id())).unwrap();
    let files = limits.lines().find(|it| it.starts_with("Max open files"));
    let files: Vec<_> = files.unwrap().split_whitespace().collect();
    assert_eq!(files[3..5], ["300", "300"]);
}
