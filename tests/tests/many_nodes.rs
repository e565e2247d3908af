//! A process with hundreds of nodes and few descriptors.

use sm2_test_support::{ran_alone, skip};
use std::fs;

use nix::sys::resource::{Resource, getrlimit, setrlimit};
use sm2_node::{Node, Subscriber};
use sm2_tests::{actor::Actor, domain::TempDomain, eventually};

const MOST_NODES: usize = 200;
/// With fewer of them, a few descriptors more or less would decide.
const LEAST_NODES: usize = 20;
const PUBLISHERS: usize = 3;

/// More than the descriptors of a node and of its links.
const DESCRIPTORS_PER_NODE: usize = 20;

/// The descriptors that the library leaves to the program.
const RESERVE: usize = 64;

fn open_links(subscribers: &[Subscriber<[u8]>]) -> usize {
    let links = subscribers.iter().flat_map(Subscriber::links);
    links.filter(|link| link.open).count()
}

/// Links that a lack of descriptors holds up cost no node its session, and they are made when there is room.
//= SM2-LNK-007, SM2-TRN-011 sys
#[test]
fn the_nodes_of_a_process_share_its_descriptors() {
    if ran_alone(concat!(
        module_path!(),
        "::the_nodes_of_a_process_share_its_descriptors"
    )) {
        return;
    }
    let (_, most) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    let count = MOST_NODES.min(most as usize / DESCRIPTORS_PER_NODE);
    if count < LEAST_NODES {
        skip(format_args!("a process may have only {most} descriptors"));
        return;
    }
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let mut crowd = Actor::start(&domain.socket(), "crowd");
    let wanted = count * PUBLISHERS;
    // A third of the links finds a descriptor; each needs at least one.
    let free = RESERVE + count;
    setrlimit(Resource::RLIMIT_NOFILE, most, most).unwrap();
    let connect = |number| {
        let builder = Node::builder(&format!("n{number}")).socket(domain.socket());
        builder.background(false).connect().expect("a session")
    };
    let nodes: Vec<Node> = (0..count).map(connect).collect();
    let subscribers: Vec<_> = (nodes.iter())
        .map(|node| node.subscriber::<[u8]>("t").expect("granted"))
        .collect();
    let used = fs::read_dir("/proc/self/fd").unwrap().count();
    setrlimit(Resource::RLIMIT_NOFILE, (used + free) as u64, most).unwrap();
    for publisher in 0..PUBLISHERS {
        crowd.tell(&format!("pub c{publisher} t"));
    }
    eventually("some links", || open_links(&subscribers) >= count / 4);
    // Every call drives its node: all of them settle on what there is.
    for _ in 0..20 {
        let open = open_links(&subscribers);
        assert!(open < wanted, "no shortage: {open} links");
        assert!(nodes.iter().all(Node::is_connected), "a session ended");
    }

    setrlimit(Resource::RLIMIT_NOFILE, most, most).unwrap();
    eventually("all links", || open_links(&subscribers) == wanted);
    assert!(nodes.iter().all(Node::is_connected), "a session ended");
    crowd.tell(&format!("wait c0 {count}"));
    crowd.tell("publish c0 1 100");
    for subscriber in &subscribers {
        eventually("the message", || subscriber.try_recv().unwrap().is_some());
        assert_eq!(subscriber.lost(), 0);
    }
}
