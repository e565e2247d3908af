//! Events while a domain has no Manager, and their effects on the next Manager.

use sm2_proto::{Farewell, LinkId, control::Item, control::ToNode};
use sm2_tests::{
    actor::Actor,
    control::{self, Claim, Qos},
    domain::{ManagerProcess, TempDomain},
    eventually,
    raw::{RawLink, RawNode},
};

/// A raw talker and a raw listener, and the link between them.
fn linked(manager: &ManagerProcess) -> [RawLink; 2] {
    let nodes = [manager.node("talker"), manager.node("listener")];
    nodes[0].declare(1, &control::publisher("t", Qos::PLAIN));
    nodes[1].declare(1, &control::subscriber("t", Qos::PLAIN));
    [nodes[0].linked(), nodes[1].linked()]
}

/// The claim of a link's end.
fn claim(link: &RawLink) -> Claim {
    Claim {
        interface: link.interface,
        link: link.id,
        key: link.key,
        version: 1,
        reliable: link.reliable,
        sealed: link.sealed,
    }
}

/// Reconnects as the talker or the listener, and declares interface 1 again.
fn back(manager: &ManagerProcess, name: &str) -> RawNode {
    let node = manager.connect();
    node.greet_again(name);
    let contract = match name {
        "listener" => control::subscriber("t", Qos::PLAIN),
        _ => control::publisher("t", Qos::PLAIN),
    };
    assert_eq!(node.declare(1, &contract), 0, "nothing before CLAIMED");
    node
}

/// The links and claims of the domain.
fn links(observer: &RawNode) -> (Vec<LinkId>, Vec<LinkId>) {
    let items = observer.query_all();
    let links = items.iter().filter_map(|item| match item {
        Item::Link { link, .. } => Some(*link),
        _ => None,
    });
    let claims = items.iter().filter_map(|item| match item {
        Item::Claim { link, .. } => Some(*link),
        _ => None,
    });
    (links.collect(), claims.collect())
}

#[track_caller]
fn talk(ends: &[RawLink; 2]) {
    ends[0].end.send(b"still here");
    assert_eq!(ends[1].end.expect().bytes, b"still here");
}

//= SM2-RES-002, SM2-RES-004 sys
#[test]
fn a_link_that_both_ends_claim_is_adopted_without_a_word() {
    let domain = TempDomain::new();
    let mut first = domain.manager();
    let ends = linked(&first);
    first.kill();
    let second = domain.manager();
    let nodes = [back(&second, "talker"), back(&second, "listener")];
    for (node, end) in nodes.iter().zip(&ends) {
        node.send(claim(end).bytes());
        node.send(control::claimed());
    }
    let observer = second.node("observer");
    eventually("the adoption", || {
        links(&observer) == (vec![ends[0].id], vec![])
    });
    talk(&ends);
    assert!(nodes.iter().all(|node| node.peer().is_quiet()));
    // From here on it is an ordinary link.
    nodes[0].send(control::withdraw(1));
    assert_eq!(nodes[1].unlinked(ends[0].id), Farewell::Done.code());
}

//= SM2-RES-006, SM2-RES-007 sys
#[test]
fn a_link_that_one_end_has_dropped_is_closed_and_the_pair_linked_anew() {
    let domain = TempDomain::new();
    let mut first = domain.manager();
    let [talker, listener] = linked(&first);
    first.kill();
    drop(listener);
    let second = domain.manager_with(&["--recovery-ms", "1000"]);
    let nodes = [back(&second, "talker"), back(&second, "listener")];
    nodes[1].send(control::claimed());
    // Its time starts with CLAIMED, which also links the pair anew: the listener has claimed everything.
    nodes[0].send(claim(&talker).bytes());
    nodes[0].send(control::claimed());
    let fresh = [nodes[0].linked(), nodes[1].linked()];
    assert_eq!(fresh[0].id, fresh[1].id);
    assert_ne!(fresh[0].id, talker.id);
    talk(&fresh);
    // The other end does not claim it in time.
    assert_eq!(nodes[0].unlinked(talker.id), Farewell::PeerGone.code());
    nodes[0].send(control::unlinked(1, talker.id, 0));
    assert_eq!(nodes[0].nodes(), ["talker", "listener"]);
    assert_eq!(links(&nodes[0]), (vec![fresh[0].id], vec![]));
}

//= SM2-RES-004, SM2-LNK-002 sys
#[test]
fn whoever_does_not_know_the_key_of_a_link_can_neither_take_it_nor_end_it() {
    let domain = TempDomain::new();
    let mut first = domain.manager();
    let ends = linked(&first);
    first.kill();
    let second = domain.manager();
    // Nodes under other names claim both ends with a wrong key, before the owners reconnect.
    let thieves = ["thief", "other-thief"].map(|name| {
        let thief = second.connect();
        thief.greet_again(name);
        thief.declare(1, &control::publisher("t", Qos::PLAIN));
        thief.declare(2, &control::subscriber("t", Qos::PLAIN));
        for interface in [1, 2] {
            let mut guess = claim(&ends[0]);
            guess.interface = interface;
            guess.key = guess.key.wrapping_add(interface);
            thief.send(guess.bytes());
        }
        thief
    });
    let nodes = [back(&second, "talker"), back(&second, "listener")];
    for (node, end) in nodes.iter().zip(&ends) {
        node.send(claim(end).bytes());
        node.send(control::claimed());
    }
    let observer = second.node("observer");
    eventually("the adoption", || links(&observer).0 == [ends[0].id]);
    drop(thieves);
    eventually("the thieves' end", || links(&observer).1.is_empty());
    assert_eq!(links(&observer).0, [ends[0].id]);
    talk(&ends);
    assert!(nodes.iter().all(|node| node.peer().is_quiet()));
}

//= SM2-RES-001 sys
#[test]
fn a_node_that_dies_while_there_is_no_manager_is_gone_with_its_links() {
    let domain = TempDomain::new();
    let mut first = domain.manager();
    let mut talker = Actor::start(&domain.socket(), "talker");
    let mut stays = Actor::start(&domain.socket(), "stays");
    let mut dies = Actor::start(&domain.socket(), "dies");
    talker.tell("pub t t reliable_ms=60000");
    for listener in [&mut stays, &mut dies] {
        listener.tell("sub t t reliable");
    }
    talker.tell("wait t 2");
    first.kill();
    dies.kill();
    talker.tell("publish t 8 100");
    stays.tell("take t 8");
    let second = domain.manager();
    let observer = second.node("observer");
    eventually("both that are left", || {
        let mut names = observer.nodes();
        names.sort();
        names == ["observer", "stays", "talker"]
    });
    eventually("their link", || links(&observer).0.len() == 1);
    let mut heir = Actor::start(&domain.socket(), "dies");
    heir.tell("sub t t reliable");
    talker.tell("wait t 2");
    talker.tell("publish t 8 100");
    assert!(stays.tell("take t 8").contains("got=8"));
    assert!(heir.tell("take t 8").contains("got=8"));
    assert_eq!(talker.counted_with("t", "stays").delivered, 16);
}

//= SM2-RES-001, SM2-SES-003 sys
#[test]
fn a_name_that_was_taken_across_the_gap_costs_no_link() {
    let domain = TempDomain::new();
    let mut first = domain.manager();
    let mut talker = Actor::start(&domain.socket(), "talker");
    let mut listener = Actor::start(&domain.socket(), "listener");
    talker.tell("pub t t reliable_ms=60000");
    listener.tell("sub t t reliable");
    talker.tell("wait t 1");
    let observer = first.node("observer");
    let before = links(&observer).0;
    assert_eq!(before.len(), 1);
    talker.stop();
    first.kill();
    let second = domain.manager();
    let impostor = second.node("talker");
    talker.resume();
    // The talker is refused, and continues without a session.
    talker.tell("publish t 8 100");
    assert!(listener.tell("take t 8").ends_with("lost=0 damaged=0"));
    assert!(impostor.nodes().contains(&"talker".to_owned()));
    impostor.close();
    let observer = second.node("observer");
    eventually("the link to be adopted", || links(&observer).0 == before);
    talker.tell("publish t 8 100");
    assert!(listener.tell("take t 8").ends_with("lost=0 damaged=0"));
}

//= SM2-RES-005, SM2-RES-008 sys
#[test]
fn a_new_policy_holds_from_the_first_frame() {
    let domain = TempDomain::new();
    let mut first = domain.manager();
    let ends = linked(&first);
    assert!(!ends[0].sealed);
    first.kill();
    let second = domain.manager_with(&["--seal-all", "true"]);
    let nodes = [back(&second, "talker"), back(&second, "listener")];
    for (node, end) in nodes.iter().zip(&ends) {
        node.send(claim(end).bytes());
    }
    for (node, end) in nodes.iter().zip(&ends) {
        assert_eq!(node.unlinked(end.id), Farewell::NotAdopted.code());
        node.send(control::unlinked(1, end.id, 6));
        node.send(control::claimed());
    }
    let fresh = [nodes[0].linked(), nodes[1].linked()];
    assert!(fresh.iter().all(|link| link.sealed));

    let mut second = second;
    second.kill();
    let third = domain.manager_with(&["--links-per-session", "1"]);
    let node = back(&third, "talker");
    node.send(claim(&fresh[0]).bytes());
    let mut beyond = claim(&fresh[0]);
    beyond.link.serial += 1;
    node.send(beyond.bytes());
    assert_eq!(node.unlinked(beyond.link), Farewell::Resources.code());
    node.send(control::unlinked(1, beyond.link, 4));
    node.send(control::claimed());
    node.send(control::query());
    let answer = node.next();
    assert!(matches!(answer, ToNode::Page(_)), "{answer:?}");
}
