//! A Manager under test. It takes frames, and returns its outputs as readable events.
#![allow(dead_code, reason = "each test uses a part")]

use sm2_proto::{
    Code, Contract, Datagram, FdFacts, Instant, InterfaceId, LinkId, LinkKey, Machine, NodeId,
    control::{Limit, Limits, ToManager, ToNode, decode_to_node, encode_to_manager},
    manager::{Cause, Credentials, Input, Manager, Output},
};

use super::contracts::name;

pub(crate) const EPOCH: u64 = 0xE90C;
const SECRET: u128 = 0x5EC2E7;
/// SipHash-2-4 of the bytes of 1 under that secret, computed by another implementation.
pub(crate) const FIRST_KEY: u64 = 0xFEDA_BC3F_4DF5_1929;

pub(crate) const UNLIMITED: Limits = Limits::all(u32::MAX)
    .with(Limit::Greeting, 2_000)
    .with(Limit::Recovery, 5_000)
    .with(Limit::Confirmation, 5_000);

/// One output of the Manager, with its frames decoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    Sent(NodeId, ToNode),
    Linked(LinkId, [(NodeId, ToNode); 2]),
    CountersKept(NodeId),
    /// The receiver, and the owner of the counters.
    CountersSent(NodeId, ToNode, NodeId),
    /// The driver has to read the access limits.
    PolicyWanted,
    HungUp(NodeId, Option<Code>, Cause),
}

#[derive(Clone)]
pub(crate) struct Bench {
    pub(crate) manager: Manager,
    pub(crate) now: Instant,
    connections: u64,
}

impl Bench {
    pub(crate) fn new(limits: Limits) -> Self {
        Self::with_secret(limits, SECRET)
    }

    pub(crate) fn with_secret(limits: Limits, secret: u128) -> Self {
        Self {
            manager: Manager::new(EPOCH, secret, limits),
            now: Instant(1),
            connections: 0,
        }
    }

    pub(crate) fn input(&mut self, input: Input<'_>) -> Vec<Event> {
        let taken = self.manager.handle(self.now, input);
        taken.expect("the bench keeps the contract");
        std::iter::from_fn(|| self.manager.poll())
            .map(read)
            .collect()
    }

    /// A connection of a process of its own.
    pub(crate) fn try_connect(&mut self, uid: u32) -> (NodeId, Vec<Event>) {
        let pid = 101 + i32::try_from(self.connections).expect("a test has few connections");
        self.try_connect_from(uid, pid)
    }

    pub(crate) fn try_connect_from(&mut self, uid: u32, pid: i32) -> (NodeId, Vec<Event>) {
        self.connections += 1;
        let session = NodeId(self.connections);
        let gid = uid;
        let credentials = Credentials { uid, gid, pid };
        let connected = Input::Connected {
            session,
            credentials,
        };
        (session, self.input(connected))
    }

    pub(crate) fn connect(&mut self, uid: u32) -> NodeId {
        let (session, events) = self.try_connect(uid);
        assert_eq!(events, [], "a connection is not answered");
        session
    }

    pub(crate) fn bytes(&mut self, session: NodeId, bytes: &[u8]) -> Vec<Event> {
        self.datagram(session, Datagram::new(bytes))
    }

    pub(crate) fn datagram(&mut self, session: NodeId, datagram: Datagram<'_>) -> Vec<Event> {
        self.input(Input::Datagram { session, datagram })
    }

    pub(crate) fn send(&mut self, session: NodeId, frame: &ToManager) -> Vec<Event> {
        self.bytes(session, &encode_to_manager(frame))
    }

    pub(crate) fn hello(&mut self, session: NodeId, text: &str) -> Vec<Event> {
        self.send(session, &hello(text))
    }

    /// A ready session.
    pub(crate) fn node(&mut self, uid: u32, text: &str) -> NodeId {
        let session = self.connect(uid);
        let events = self.hello(session, text);
        assert!(
            matches!(&events[..], [Event::Sent(to, ToNode::Welcome { .. })] if *to == session),
            "{text} is not welcome: {events:?}"
        );
        session
    }

    pub(crate) fn declare(
        &mut self,
        session: NodeId,
        interface: u64,
        contract: &Contract,
    ) -> Vec<Event> {
        let interface = InterfaceId(interface);
        let contract = contract.clone();
        self.send(
            session,
            &ToManager::Declare {
                interface,
                contract,
            },
        )
    }

    /// Declares an interface that must be granted. Returns the events.
    pub(crate) fn declared(
        &mut self,
        session: NodeId,
        interface: u64,
        contract: &Contract,
    ) -> Vec<LinkId> {
        let events = self.declare(session, interface, contract);
        let links: Vec<LinkId> = events
            .iter()
            .filter_map(|event| match event {
                Event::Linked(link, _) => Some(*link),
                _ => None,
            })
            .collect();
        let answer = Event::Sent(
            session,
            ToNode::Declared {
                interface: InterfaceId(interface),
                matches: u32::try_from(links.len()).expect("few links"),
            },
        );
        assert_eq!(events.first(), Some(&answer), "{events:?}");
        links
    }

    /// A claim of version 1, neither reliable nor sealed.
    pub(crate) fn claim(interface: u64, link: LinkId, key: u64) -> ToManager {
        ToManager::Claim {
            interface: InterfaceId(interface),
            link,
            key: LinkKey(key),
            version: 1,
            reliable: false,
            sealed: false,
        }
    }

    pub(crate) fn withdraw(&mut self, session: NodeId, interface: u64) -> Vec<Event> {
        self.send(session, &withdraw(interface))
    }

    pub(crate) fn unlinked(&mut self, session: NodeId, interface: u64, link: LinkId) -> Vec<Event> {
        self.send(session, &unlinked(interface, link))
    }

    pub(crate) fn suspended(&mut self, session: NodeId, interface: u64) -> Vec<Event> {
        self.send(session, &suspended(interface))
    }

    pub(crate) fn close(&mut self, session: NodeId) -> Vec<Event> {
        self.input(Input::Closed { session })
    }

    pub(crate) fn is_known(&self, session: NodeId) -> bool {
        let mut probe = self.clone();
        !probe.close(session).is_empty()
    }
}

pub(crate) fn hello(text: &str) -> ToManager {
    ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: name(text),
        resuming: false,
    }
}

pub(crate) fn resuming(text: &str) -> ToManager {
    ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: name(text),
        resuming: true,
    }
}

/// A claim of version 1, neither reliable nor sealed.
pub(crate) fn claim(interface: u64, link: LinkId, key: u64) -> ToManager {
    ToManager::Claim {
        interface: InterfaceId(interface),
        link,
        key: LinkKey(key),
        version: 1,
        reliable: false,
        sealed: false,
    }
}

pub(crate) fn withdraw(interface: u64) -> ToManager {
    let interface = InterfaceId(interface);
    ToManager::Withdraw { interface }
}

pub(crate) fn unlinked(interface: u64, link: LinkId) -> ToManager {
    ToManager::Unlinked {
        interface: InterfaceId(interface),
        link,
        code: Code(5),
    }
}

pub(crate) fn suspended(interface: u64) -> ToManager {
    ToManager::Suspended {
        interface: InterfaceId(interface),
    }
}

pub(crate) fn unlink(interface: u64, link: LinkId, code: u16) -> ToNode {
    ToNode::Unlink {
        interface: InterfaceId(interface),
        link,
        code: Code(code),
    }
}

/// The events that a node sees, in order.
pub(crate) fn seen_by(events: &[Event], node: NodeId) -> Vec<ToNode> {
    let frames = events.iter().flat_map(|event| match event {
        Event::Sent(to, frame) => vec![(*to, frame)],
        Event::Linked(_, ends) => ends.iter().map(|(to, frame)| (*to, frame)).collect(),
        Event::CountersSent(to, frame, _) => vec![(*to, frame)],
        Event::CountersKept(_) | Event::PolicyWanted | Event::HungUp(..) => Vec::new(),
    });
    let own = frames.filter(|(to, _)| *to == node);
    own.map(|(_, frame)| frame.clone()).collect()
}

/// Every frame of the Manager must be one that a node accepts.
pub(crate) fn read(output: Output) -> Event {
    match output {
        Output::Send { session, frame } => Event::Sent(session, read_frame(&frame, 0)),
        Output::Link { link, ends } => {
            Event::Linked(link, ends.map(|(to, frame)| (to, read_frame(&frame, 1))))
        }
        Output::KeepCounters { session } => Event::CountersKept(session),
        Output::SendCounters { session, frame, of } => {
            Event::CountersSent(session, read_frame(&frame, 1), of)
        }
        Output::ReadAccessPolicy => Event::PolicyWanted,
        Output::HangUp {
            session,
            goodbye,
            cause,
        } => {
            let code = goodbye.map(|goodbye| match read_frame(&goodbye, 0) {
                ToNode::Goodbye { code } => code,
                other => panic!("{other:?} is not a goodbye"),
            });
            Event::HungUp(session, code, cause)
        }
    }
}

fn read_frame(bytes: &[u8], fds: usize) -> ToNode {
    let fds = vec![FdFacts::default(); fds];
    let datagram = Datagram {
        fds: &fds,
        ..Datagram::new(bytes)
    };
    decode_to_node(&datagram).expect("the Manager sends what a node accepts")
}
