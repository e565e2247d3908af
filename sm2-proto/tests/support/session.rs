//! A node under test. It takes frames of its Manager, and returns its outputs.
#![allow(dead_code, reason = "each test uses a part")]

use sm2_proto::{
    Code, Contract, Datagram, FdFacts, Instant, InterfaceId, LinkId, LinkKey, Machine, NodeId,
    Refusal, TypeId, Violation,
    control::{
        Changes, LinkPeer, Page, ReloadOutcome, ToManager, ToNode, decode_to_manager,
        encode_to_node,
    },
    node::{End, Error, Input, Node, Output},
    schema::Schema,
};

use super::contracts::{data, name, publisher, subscriber};

pub(crate) const NOW: Instant = Instant(0);
pub(crate) const EPOCH: u64 = 5;

pub(crate) fn receive(node: &mut Node, frame: &ToNode) -> Result<Vec<Output>, Error> {
    let bytes = encode_to_node(frame);
    let fds = [FdFacts::default()];
    let datagram = Datagram {
        fds: if matches!(frame, ToNode::Link { .. } | ToNode::Inspected { .. }) {
            &fds
        } else {
            &[]
        },
        ..Datagram::new(&bytes)
    };
    let mut outputs = drain(node);
    node.handle(NOW, Input::Datagram(datagram))?;
    outputs.extend(drain(node));
    Ok(outputs)
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
        key: LinkKey(7),
        version: 1,
        reliable: false,
        sealed: false,
        peer: LinkPeer {
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
    ToNode::Page(Page {
        revision: 1,
        items: Vec::new(),
        next: None,
    })
}

pub(crate) fn changes() -> ToNode {
    ToNode::Changes(Changes {
        revision: 2,
        changes: Some(Vec::new()),
        more: false,
    })
}

/// A type, and the text that has its hash.
pub(crate) fn schema() -> (TypeId, String) {
    let text = "plain:struct{x:f64,}";
    let hash = Schema::parse(text).expect("a schema").hash();
    (
        TypeId {
            name: name("Point"),
            hash,
        },
        text.to_owned(),
    )
}

pub(crate) fn described() -> ToNode {
    let (data, text) = schema();
    ToNode::Described {
        data,
        text: Some(text),
    }
}

pub(crate) const fn reloaded() -> ToNode {
    ToNode::Reloaded {
        outcome: ReloadOutcome::Applied,
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

pub(crate) fn denied(interface: u64) -> ToNode {
    ToNode::DeclareRefused {
        interface: InterfaceId(interface),
        reason: Refusal::Denied { rule: None },
    }
}

/// Makes every request: a page, changes, the counters of node 4, a schema, and the policy read again.
pub(crate) fn ask(node: &mut Node) {
    for input in [
        Input::Query { after: None },
        Input::Watch { after: 1 },
        Input::Inspect { node: NodeId(4) },
        Input::Describe { data: schema().0 },
        Input::Reload,
    ] {
        node.handle(NOW, input).expect("welcomed");
    }
}

/// A ready node with interface 1 *live* with link 1, 2 *declaring*, and every request open.
pub(crate) fn ready() -> Node {
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    node.declare(contract()).expect("ready");
    receive(&mut node, &declared(1)).expect("legal");
    receive(&mut node, &link(1, 1)).expect("legal");
    node.declare(contract()).expect("ready");
    ask(&mut node);
    drain(&mut node);
    node
}

pub(crate) const LATER: u64 = 6;

pub(crate) fn welcome_in(epoch: u64) -> ToNode {
    ToNode::Welcome {
        version: 1,
        epoch,
        node: NodeId(8),
    }
}

/// The claim of the link that [`link`] made.
pub(crate) fn claim(interface: u64) -> ToManager {
    claim_of(interface, 1)
}

pub(crate) fn claim_of(interface: u64, serial: u64) -> ToManager {
    ToManager::Claim {
        interface: InterfaceId(interface),
        link: link_id(serial),
        key: LinkKey(7),
        version: 1,
        reliable: false,
        sealed: false,
    }
}

/// The session is over, and another one has begun, with a Manager of the epoch [`LATER`].
pub(crate) fn come_back(node: &mut Node) -> Vec<Output> {
    node.handle(NOW, Input::Eof).expect("a session");
    node.handle(NOW, Input::Reconnected).expect("away");
    drain(node);
    receive(node, &welcome_in(LATER)).expect("legal")
}

/// Interface 1 in some state, with link 1 where it can have one.
pub(crate) fn interface_in(state: &str) -> Node {
    let mut node = Node::new(name("lidar"));
    receive(&mut node, &welcome()).expect("legal");
    let interface = node.declare(contract()).expect("ready");
    if state == "declaring" {
        drain(&mut node);
        return node;
    }
    receive(&mut node, &declared(1)).expect("legal");
    receive(&mut node, &link(1, 1)).expect("legal");
    if state == "unclaimed" {
        node.declare(contract()).expect("ready");
        receive(&mut node, &declared(2)).expect("legal");
    }
    if !["live", "suspended", "dropping", "gone"].contains(&state) {
        come_back(&mut node);
    }
    if ["dropping", "gone", "doomed"].contains(&state) {
        node.handle(NOW, Input::Withdraw { interface })
            .expect("declared");
    }
    match state {
        "live" | "dropping" | "renewing" | "doomed" => {}
        "suspended" => drop(receive(&mut node, &denied(1)).expect("legal")),
        "gone" => drop(receive(&mut node, &withdrawn(1)).expect("legal")),
        "unclaimed" | "claimed" => drop(receive(&mut node, &declared(1)).expect("legal")),
        "dormant" => drop(receive(&mut node, &refused(1)).expect("legal")),
        other => panic!("{other} is not a state"),
    }
    drain(&mut node);
    node
}

pub(crate) fn violation(node: &mut Node, frame: &ToNode) -> Violation {
    match receive(node, frame) {
        Err(Error::Ended(End::Violation(violation))) => violation,
        other => panic!("{frame:?} is not a violation: {other:?}"),
    }
}
