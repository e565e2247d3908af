//! A node on the bench: what its Manager sends it, and what comes of that.
#![allow(dead_code, reason = "each test uses a part")]

use sm2_proto::{
    Code, Contract, Datagram, FdFacts, Instant, InterfaceId, LinkId, NodeId, Refusal, Violation,
    control::{Peer, ToManager, ToNode, decode_to_manager, encode_to_node},
    node::{End, Error, Input, Node, Output},
};

use super::contracts::{data, name, publisher, subscriber};

pub(crate) const NOW: Instant = Instant(0);
pub(crate) const EPOCH: u64 = 5;

pub(crate) fn receive(node: &mut Node, frame: &ToNode) -> Result<Vec<Output>, Error> {
    let bytes = encode_to_node(frame);
    let fds = [FdFacts::default()];
    let datagram = Datagram {
        fds: if matches!(frame, ToNode::Link { .. }) {
            &fds
        } else {
            &[]
        },
        ..Datagram::new(&bytes)
    };
    node.handle(NOW, Input::Datagram(datagram))?;
    Ok(drain(node))
}

pub(crate) fn drain(node: &mut Node) -> Vec<Output> {
    std::iter::from_fn(|| node.poll()).collect()
}

pub(crate) fn sent(outputs: &[Output]) -> Vec<ToManager> {
    let frames = outputs.iter().filter_map(|output| match output {
        Output::Transmit(bytes) => Some(bytes),
        _ => None,
    });
    let read = |bytes: &Vec<u8>| decode_to_manager(&Datagram::new(bytes));
    frames
        .map(|bytes| read(bytes).expect("a node sends what a Manager accepts"))
        .collect()
}

pub(crate) fn contract() -> Contract {
    publisher("scan", &data("Scan"))
}

pub(crate) fn link_id(serial: u64) -> LinkId {
    LinkId {
        epoch: EPOCH,
        serial,
    }
}

pub(crate) fn welcome() -> ToNode {
    ToNode::Welcome {
        version: 1,
        epoch: EPOCH,
        node: NodeId(3),
    }
}

pub(crate) fn declared(interface: u64) -> ToNode {
    ToNode::Declared {
        interface: InterfaceId(interface),
        matches: 0,
    }
}

pub(crate) fn link(interface: u64, serial: u64) -> ToNode {
    ToNode::Link {
        interface: InterfaceId(interface),
        link: link_id(serial),
        version: 1,
        reliable: false,
        sealed: false,
        peer: Peer {
            node: NodeId(9),
            name: name("planner"),
            interface: InterfaceId(1),
            contract: subscriber("scan", None),
        },
    }
}

pub(crate) fn unlink(interface: u64, serial: u64) -> ToNode {
    ToNode::Unlink {
        interface: InterfaceId(interface),
        link: link_id(serial),
        code: Code(5),
    }
}

pub(crate) fn withdrawn(interface: u64) -> ToNode {
    let interface = InterfaceId(interface);
    ToNode::Withdrawn { interface }
}

pub(crate) fn page() -> ToNode {
    ToNode::Page {
        revision: 1,
        items: Vec::new(),
        next: None,
    }
}

pub(crate) fn refused(interface: u64) -> ToNode {
    ToNode::DeclareRefused {
        interface: InterfaceId(interface),
        reason: Refusal::TopicType {
            theirs: data("Image"),
        },
    }
}

/// A ready node with interface 1 *live* with link 1, 2 *declaring*, and a query open.
pub(crate) fn ready() -> Node {
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    node.declare(contract()).expect("ready");
    receive(&mut node, &declared(1)).expect("legal");
    receive(&mut node, &link(1, 1)).expect("legal");
    node.declare(contract()).expect("ready");
    node.handle(NOW, Input::Query { after: None })
        .expect("ready");
    drain(&mut node);
    node
}

/// Interface 1 in some state, with link 1 where it can have one.
pub(crate) fn interface_in(state: &str) -> Node {
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    let interface = node.declare(contract()).expect("ready");
    if state != "declaring" {
        receive(&mut node, &declared(1)).expect("legal");
        receive(&mut node, &link(1, 1)).expect("legal");
    }
    if state == "dropping" || state == "gone" {
        node.handle(NOW, Input::Withdraw { interface })
            .expect("live");
    }
    if state == "gone" {
        receive(&mut node, &withdrawn(1)).expect("legal");
    }
    drain(&mut node);
    node
}

pub(crate) fn violation(node: &mut Node, frame: &ToNode) -> Violation {
    match receive(node, frame) {
        Err(Error::Ended(End::Violation(violation))) => violation,
        other => panic!("{frame:?} is no violation: {other:?}"),
    }
}
