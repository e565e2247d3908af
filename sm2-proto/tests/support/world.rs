//! The shipped Manager and shipped nodes, joined by queues that behave as seqpacket sockets do:
//! first in, first out, and the end of the stream last.

mod checks;

use std::collections::{BTreeMap, VecDeque};

use sm2_proto::{
    Code, Contract, Datagram, FdFacts, Instant, InterfaceId, LinkId, Machine, Name, NodeId, Seals,
    control::{Limit, Limits, decode_to_manager},
    manager::{Cause, Credentials, Input, Manager, Output},
    node::{self, Node},
};

use super::{
    bench::{EPOCH, Event, read},
    onlooker::Onlooker,
    oracle::{End, LinkQos, Oracle},
};

const NOW: Instant = Instant(1);

/// The kernel's facts about one end of a link's socket pair.
const SOCKET: FdFacts = FdFacts {
    regular: false,
    size_bytes: 0,
    seals: Seals(0),
};

/// The default limits, except that no node is sent more than this many LINKs ahead of its reading.
fn limits(links_in_flight: usize) -> Limits {
    let links_in_flight = u32::try_from(links_in_flight).expect("a small number");
    Limits::default().with(Limit::LinksInFlight, links_in_flight)
}

/// The two directions of one connection. Datagrams that a closed end has not read are lost.
#[derive(Clone, Debug, Default)]
struct Socket {
    to_manager: VecDeque<Vec<u8>>,
    /// Each datagram with its descriptors.
    to_node: VecDeque<(Vec<u8>, &'static [FdFacts])>,
    /// The node's end is closed, and the Manager has not read to the end of the stream.
    node_is_gone: bool,
    /// The Manager's end is closed, and the node has not read to the end of the stream.
    manager_is_gone: bool,
}

/// A program with one node that carries out all outputs.
#[derive(Clone, Debug)]
struct Process {
    session: NodeId,
    node: Node,
    live: Vec<InterfaceId>,
    links: BTreeMap<(InterfaceId, LinkId), (End, LinkQos)>,
}

#[derive(Clone, Debug)]
pub(crate) struct World {
    manager: Manager,
    oracle: Oracle,
    sockets: BTreeMap<NodeId, Socket>,
    processes: Vec<Option<Process>>,
    connections: u64,
    /// How many of the next links find no descriptors.
    shortage: u8,
    /// Links that found no descriptors and that the oracle does not know yet.
    failed: Vec<LinkId>,
    /// A node that reads the domain all the time.
    onlooker: Onlooker,
    /// All that each node has read.
    trace: Vec<(NodeId, Vec<u8>)>,
    /// Whether rogues send their bytes, or only close their connection.
    rogues: bool,
    /// Its limit.
    links_in_flight: usize,
}

impl World {
    /// No node is sent more than this many LINKs ahead of its reading.
    pub(crate) fn new(slots: usize, rogues: bool, links_in_flight: usize) -> Self {
        let limits = self::limits(links_in_flight);
        Self {
            manager: Manager::new(EPOCH, 1, limits),
            oracle: Oracle::new(links_in_flight),
            sockets: BTreeMap::new(),
            processes: vec![None; slots],
            connections: 0,
            shortage: 0,
            failed: Vec::new(),
            onlooker: Onlooker::new(limits),
            trace: Vec::new(),
            rogues,
            links_in_flight,
        }
    }

    fn slot(&self, slot: usize) -> usize {
        slot % self.processes.len()
    }

    fn connect(&mut self, uid: u32) -> NodeId {
        self.connections += 1;
        let session = NodeId(self.connections);
        self.sockets.insert(session, Socket::default());
        self.oracle.connected(session, uid);
        let credentials = Credentials {
            uid,
            gid: uid,
            pid: 0,
        };
        let events = self.feed(Input::Connected {
            session,
            credentials,
        });
        assert_eq!(events, []);
        session
    }

    // The actions of programs.

    pub(crate) fn start(&mut self, slot: usize, name: Name, uid: u32) {
        let slot = self.slot(slot);
        if self.processes[slot].is_none() {
            self.processes[slot] = Some(Process {
                session: self.connect(uid),
                node: Node::new(name),
                live: Vec::new(),
                links: BTreeMap::new(),
            });
            self.drain(slot);
        }
    }

    pub(crate) fn declare(&mut self, slot: usize, contract: Contract) {
        let slot = self.slot(slot);
        if let Some(process) = &mut self.processes[slot]
            && process.node.is_ready()
        {
            process.node.declare(contract).expect("the node is ready");
            self.drain(slot);
        }
    }

    pub(crate) fn withdraw(&mut self, slot: usize, pick: usize) {
        let slot = self.slot(slot);
        if let Some(process) = &mut self.processes[slot]
            && !process.live.is_empty()
        {
            let interface = process.live.remove(pick % process.live.len());
            let links: Vec<LinkId> = process.links.keys().map(|&(_, link)| link).collect();
            process.links.retain(|&(it, _), _| it != interface);
            self.tell(slot, node::Input::Withdraw { interface });
            // The machines of their links end too, and no UNLINKED must follow.
            let code = Code(0);
            for link in links {
                self.tell(
                    slot,
                    node::Input::Unlinked {
                        interface,
                        link,
                        code,
                    },
                );
            }
        }
    }

    /// A link's machine ends: by CLOSE, its peer's death, or a violation on the link.
    pub(crate) fn end_link(&mut self, slot: usize, pick: usize) {
        let slot = self.slot(slot);
        let process = self.processes[slot].as_mut();
        let key = process.and_then(|process| {
            let pick = pick % process.links.len().max(1);
            let (&key, _) = process.links.iter().nth(pick)?;
            process.links.remove(&key);
            Some(key)
        });
        if let Some((interface, link)) = key {
            let code = Code(5);
            self.tell(
                slot,
                node::Input::Unlinked {
                    interface,
                    link,
                    code,
                },
            );
        }
    }

    pub(crate) fn query(&mut self, slot: usize) {
        let slot = self.slot(slot);
        let process = self.processes[slot].as_ref();
        if process.is_some_and(|process| process.node.is_ready()) {
            self.tell(slot, node::Input::Query { after: None });
        }
    }

    pub(crate) fn say_goodbye(&mut self, slot: usize) {
        let slot = self.slot(slot);
        if self.processes[slot].is_some() {
            self.tell(slot, node::Input::Close(Code(0)));
        }
    }

    pub(crate) fn crash(&mut self, slot: usize) {
        let slot = self.slot(slot);
        if let Some(process) = self.processes[slot].take() {
            self.node_closes(process.session);
        }
    }

    /// The Manager gives up a program that does not read.
    pub(crate) fn stall(&mut self, slot: usize) {
        let slot = self.slot(slot);
        let Some(session) = self.processes[slot].as_ref().map(|it| it.session) else {
            return;
        };
        if !self.sockets[&session].manager_is_gone {
            self.feed(Input::Stalled { session });
            self.oracle.gone(session);
            self.check_listing();
        }
    }

    /// A program attacks the Manager and dies. The program may have come only for that.
    pub(crate) fn go_rogue(&mut self, slot: usize, bytes: &[u8]) {
        let slot = self.slot(slot);
        let session = match self.processes[slot].take() {
            Some(process) => process.session,
            None => self.connect(1000),
        };
        match self.sockets.get_mut(&session) {
            Some(socket) if self.rogues && !socket.manager_is_gone => {
                socket.to_manager.push_back(bytes.to_vec());
                socket.to_node.clear();
                // No state of the program is left once the Manager hangs up.
                socket.node_is_gone = true;
            }
            _ => self.node_closes(session),
        }
    }

    pub(crate) fn run_short(&mut self, links: u8) {
        self.shortage = links;
    }

    fn tell(&mut self, slot: usize, input: node::Input<'_>) {
        let process = self.processes[slot].as_mut().expect("it runs");
        let taken = process.node.handle(NOW, input);
        taken.expect("no Manager breaks SPEC, and no program misuses its node");
        self.drain(slot);
    }

    fn drain(&mut self, slot: usize) {
        while let Some(process) = &mut self.processes[slot]
            && let Some(output) = process.node.poll()
        {
            match output {
                node::Output::Transmit(bytes) => {
                    if let Some(socket) = self.sockets.get_mut(&process.session)
                        && !socket.manager_is_gone
                    {
                        socket.to_manager.push_back(bytes);
                    }
                }
                node::Output::HelloRefused(_) => {
                    let name = format!("again-{}", process.session.0);
                    let name = Name::new(&name).expect("legal");
                    let greeted = process.node.handle(NOW, node::Input::Greet(name));
                    greeted.expect("it was refused");
                }
                node::Output::Declared { interface, .. } => process.live.push(interface),
                node::Output::Linked {
                    interface,
                    link,
                    qos,
                    peer,
                    ..
                } => {
                    let (reliable, sealed) = (qos.reliable, qos.sealed);
                    let qos = LinkQos { reliable, sealed };
                    let link = (interface, link);
                    let other = ((peer.node, peer.interface), qos);
                    assert_eq!(process.links.insert(link, other), None);
                }
                node::Output::Unlink {
                    interface, link, ..
                } => {
                    let known = process.links.remove(&(interface, link));
                    assert!(known.is_some(), "told once, of what it knows");
                }
                node::Output::Ended(_) => {
                    let session = process.session;
                    self.processes[slot] = None;
                    self.node_closes(session);
                }
                node::Output::Welcomed { .. }
                | node::Output::DeclareRefused { .. }
                | node::Output::Withdrawn { .. }
                | node::Output::Page(_) => {}
                other => panic!("nobody asked for {other:?}"),
            }
        }
    }

    // The actions of the kernel.

    fn node_closes(&mut self, session: NodeId) {
        if let Some(socket) = self.sockets.get_mut(&session) {
            socket.to_node.clear();
            socket.node_is_gone = true;
            if socket.manager_is_gone {
                self.sockets.remove(&session);
            }
        }
    }

    fn manager_closes(&mut self, session: NodeId) {
        if let Some(socket) = self.sockets.get_mut(&session) {
            socket.to_manager.clear();
            socket.manager_is_gone = true;
            if socket.node_is_gone {
                self.sockets.remove(&session);
            }
        }
    }

    /// The Manager reads from one of the sockets with datagrams. Returns whether there was one.
    pub(crate) fn manager_reads(&mut self, pick: usize) -> bool {
        let readable = self.sockets.iter().filter(|(_, socket)| {
            !socket.manager_is_gone && (!socket.to_manager.is_empty() || socket.node_is_gone)
        });
        let readable: Vec<NodeId> = readable.map(|(&session, _)| session).collect();
        let Some(&session) = readable.get(pick % readable.len().max(1)) else {
            return false;
        };
        let socket = self.sockets.get_mut(&session).expect("it is readable");
        match socket.to_manager.pop_front() {
            Some(bytes) => {
                let datagram = Datagram::new(&bytes);
                let events = self.feed(Input::Datagram { session, datagram });
                if let Some(Event::HungUp(_, _, Cause::Violation(rule))) = events.last() {
                    let mut processes = self.processes.iter().flatten();
                    let correct = processes.any(|process| process.session == session);
                    assert!(!correct, "{session} keeps to SPEC, but: {rule}");
                    self.oracle.gone(session);
                } else {
                    let frame = decode_to_manager(&datagram).expect("it was legal");
                    self.oracle.handled(session, frame, &events);
                }
                self.hear_of_failures();
            }
            None => {
                self.feed(Input::Closed { session });
                self.oracle.gone(session);
            }
        }
        self.check_listing();
        true
    }

    /// One of the nodes with datagrams reads. Returns whether there was one.
    pub(crate) fn node_reads(&mut self, pick: usize) -> bool {
        let mut readable = Vec::new();
        for (slot, process) in self.processes.iter().enumerate() {
            let socket = process.as_ref().map(|it| (it, &self.sockets[&it.session]));
            if let Some((process, socket)) = socket
                && (!socket.to_node.is_empty() || socket.manager_is_gone)
            {
                readable.push((slot, process.session));
            }
        }
        let Some(&(slot, session)) = readable.get(pick % readable.len().max(1)) else {
            return false;
        };
        let socket = self.sockets.get_mut(&session).expect("it is readable");
        let Some((bytes, fds)) = socket.to_node.pop_front() else {
            self.tell(slot, node::Input::Eof);
            return true;
        };
        if socket.to_node.is_empty() && self.manager.awaits_room(session) {
            let drained = self.manager.handle(NOW, Input::Drained { session });
            drained.expect("the driver keeps the contract");
            assert_eq!(self.manager.poll(), None);
        }
        self.trace.push((session, bytes.clone()));
        let datagram = Datagram {
            fds,
            ..Datagram::new(&bytes)
        };
        self.tell(slot, node::Input::Datagram(datagram));
        true
    }

    /// The Manager does a part of its deferred work. Returns whether there was any.
    pub(crate) fn tick(&mut self) -> bool {
        let due = self.manager.deadline().is_some_and(|due| due <= NOW);
        if due {
            let events = self.feed(Input::Tick);
            self.oracle.ticked(&events);
            self.hear_of_failures();
            self.check_listing();
        }
        due
    }

    fn hear_of_failures(&mut self) {
        for link in std::mem::take(&mut self.failed) {
            self.oracle.link_failed(link);
        }
    }

    /// Everything in flight arrives.
    pub(crate) fn run_until_quiet(&mut self) {
        while self.manager_reads(0) | self.node_reads(0) | self.tick() {}
        self.check_links();
    }

    fn feed(&mut self, input: Input<'_>) -> Vec<Event> {
        let taken = self.manager.handle(NOW, input);
        taken.expect("the driver keeps the contract");
        let mut events = Vec::new();
        let mut outputs = Vec::new();
        while let Some(output) = self.manager.poll() {
            outputs.push(output);
        }
        for output in outputs {
            events.push(read(output.clone()));
            self.carry_out(output);
        }
        events
    }

    fn carry_out(&mut self, output: Output) {
        match output {
            Output::Send { session, frame } => self.send(session, frame, &[]),
            Output::Link { link, ends } => {
                if self.shortage > 0 {
                    self.shortage -= 1;
                    let failed = self.manager.handle(NOW, Input::LinkFailed { link });
                    failed.expect("the driver keeps the contract");
                    assert_eq!(self.manager.poll(), None);
                    self.failed.push(link);
                    return;
                }
                for (session, frame) in ends {
                    self.send(session, frame, &[SOCKET]);
                }
            }
            Output::KeepCounters { .. } | Output::SendCounters { .. } => panic!("nobody counts"),
            Output::ReadAccessPolicy => panic!("nobody asks for it"),
            Output::HangUp {
                session, goodbye, ..
            } => {
                if let Some(goodbye) = goodbye {
                    self.send(session, goodbye, &[]);
                }
                self.manager_closes(session);
            }
        }
    }

    fn send(&mut self, session: NodeId, frame: Vec<u8>, fds: &'static [FdFacts]) {
        if let Some(socket) = self.sockets.get_mut(&session)
            && !socket.node_is_gone
        {
            socket.to_node.push_back((frame, fds));
            self.check_pace(session);
        }
    }
}
