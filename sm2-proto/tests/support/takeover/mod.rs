//! A domain without a kernel, where Managers come and go, and nodes stay.

mod check;
mod nodes;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use sm2_proto::{
    Code, Contract, Datagram, Farewell, FdFacts, Instant, InterfaceId, LinkId, Machine, NodeId,
    control::{Limit, Limits, ToNode, decode_to_node},
    domain::Mirror,
    manager::{self, Cause, Credentials, Manager},
    node::{self, Node},
};

use crate::support::contracts::name;

pub(crate) const NODES: usize = 3;
const USER: Credentials = Credentials {
    uid: 1_000,
    gid: 1_000,
    pid: 1,
};

/// The state of one end of a link's socket pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Socket {
    Underway,
    Held,
    Closed,
}

/// A link's two ends, as the Manager that made it numbered them.
#[derive(Clone, Debug)]
struct Pair {
    ends: [(usize, InterfaceId); 2],
    sockets: [Socket; 2],
    /// Whether any side had a reason to end the link.
    doomed: bool,
}

#[derive(Clone, Debug)]
struct NodeInterface {
    contract: Contract,
    answered: bool,
    /// True if the current Manager refused the interface, though an earlier one had granted it.
    refused: bool,
}

/// A datagram or event that a node has still to read.
#[derive(Clone, Debug)]
enum Down {
    Frame(Vec<u8>, Option<LinkId>),
    Eof,
}

#[derive(Clone, Debug)]
struct Connection {
    session: NodeId,
    up: VecDeque<Vec<u8>>,
    down: VecDeque<Down>,
}

#[derive(Debug)]
struct Program {
    node: Node,
    connection: Option<Connection>,
    /// Connections that the node has closed, and whose remaining datagrams the Manager has not
    /// read.
    closed: VecDeque<Connection>,
    interfaces: BTreeMap<InterfaceId, NodeInterface>,
    links: BTreeSet<(InterfaceId, LinkId)>,
    mirror: Mirror,
}

#[derive(Debug)]
pub(crate) struct World {
    limits: Limits,
    now: Instant,
    epoch: u64,
    sessions: u64,
    manager: Option<Manager>,
    programs: Vec<Program>,
    pairs: BTreeMap<LinkId, Pair>,
    /// Pairs that the present Manager need not link, because one side ended their link.
    broken: BTreeSet<[(usize, InterfaceId); 2]>,
}

impl World {
    #[allow(dead_code, reason = "not every test chooses a limits")]
    pub(crate) fn new() -> Self {
        Self::with(Limits::default())
    }

    pub(crate) fn with(limits: Limits) -> Self {
        let program = |at: usize| Program {
            node: Node::new(name(["lidar", "planner", "arm"][at])),
            connection: None,
            closed: VecDeque::new(),
            interfaces: BTreeMap::new(),
            links: BTreeSet::new(),
            mirror: Mirror::new(),
        };
        let mut world = Self {
            limits,
            now: Instant(1),
            epoch: 0,
            sessions: 0,
            manager: None,
            programs: (0..NODES).map(program).collect(),
            pairs: BTreeMap::new(),
            broken: BTreeSet::new(),
        };
        world.start();
        for at in 0..NODES {
            world.connect(at);
            world.node_works(at, None);
        }
        world
    }

    pub(crate) fn start(&mut self) {
        if self.manager.is_none() {
            self.epoch += 1;
            self.manager = Some(Manager::new(self.epoch, 7, self.limits));
            self.broken.clear();
        }
    }

    fn connect(&mut self, at: usize) {
        self.sessions += 1;
        let session = NodeId(self.sessions);
        self.programs[at].connection = Some(Connection {
            session,
            up: VecDeque::new(),
            down: VecDeque::new(),
        });
        self.feed_manager(manager::Input::Connected {
            session,
            credentials: USER,
        });
    }

    pub(crate) fn reconnect(&mut self, at: usize) {
        if self.manager.is_none() || !self.programs[at].node.is_away() {
            return;
        }
        // A Manager reads the ends of old connections before it accepts new ones.
        while self.manager_reads_closed(at) {}
        self.connect(at);
        self.feed_node(at, node::Input::Reconnected, None);
    }

    pub(crate) fn declare(&mut self, at: usize, contract: Contract) {
        let program = &mut self.programs[at];
        if let Ok(interface) = program.node.declare(contract.clone()) {
            let declared = NodeInterface {
                contract,
                answered: false,
                refused: false,
            };
            program.interfaces.insert(interface, declared);
            self.node_works(at, None);
        }
    }

    pub(crate) fn withdraw(&mut self, at: usize, pick: usize) {
        let program = &mut self.programs[at];
        let Some(&interface) = program.interfaces.keys().nth(pick) else {
            return;
        };
        let withdrawn = node::Input::Withdraw { interface };
        if program.node.handle(self.now, withdrawn).is_err() {
            // The interface is being declared.
            return;
        }
        program.interfaces.remove(&interface);
        let ends: Vec<_> = program.links.iter().copied().collect();
        for (ours, link) in ends {
            if ours == interface {
                self.doom(link);
                self.close_end(at, interface, link);
            }
        }
        self.doom_underway(at, Some(interface));
        self.node_works(at, None);
    }

    pub(crate) fn break_link(&mut self, at: usize, pick: usize) {
        let Some(&(interface, link)) = self.programs[at].links.iter().nth(pick) else {
            return;
        };
        self.doom(link);
        let mut ends = self.pairs[&link].ends;
        ends.sort_unstable();
        self.broken.insert(ends);
        self.close_end(at, interface, link);
        self.say_unlinked(at, interface, link, Code(71));
    }

    /// The other end of a link is closed, so this end is closed as well.
    pub(crate) fn notice(&mut self, at: usize) {
        for (interface, link) in self.programs[at].links.clone() {
            let Pair { ends, sockets, .. } = &self.pairs[&link];
            let ours = end_of(ends, at, interface);
            if sockets[1 - ours] == Socket::Closed {
                self.close_end(at, interface, link);
                self.say_unlinked(at, interface, link, Farewell::PeerGone.code());
            }
        }
    }

    fn say_unlinked(&mut self, at: usize, interface: InterfaceId, link: LinkId, code: Code) {
        let unlinked = node::Input::Unlinked {
            interface,
            link,
            code,
        };
        self.feed_node(at, unlinked, None);
    }

    fn doom(&mut self, link: LinkId) {
        if let Some(pair) = self.pairs.get_mut(&link) {
            pair.doomed = true;
        }
    }

    /// Links that a node, or one of its interfaces, has not seen yet.
    fn doom_underway(&mut self, at: usize, interface: Option<InterfaceId>) {
        let touches = |pair: &Pair| {
            let ours = |end: &(usize, InterfaceId)| {
                end.0 == at && interface.is_none_or(|interface| interface == end.1)
            };
            pair.ends.iter().any(ours)
        };
        for pair in self.pairs.values_mut().filter(|pair| touches(pair)) {
            pair.doomed = true;
        }
    }

    fn close_end(&mut self, at: usize, interface: InterfaceId, link: LinkId) {
        self.programs[at].links.remove(&(interface, link));
        if let Some(Pair { ends, sockets, .. }) = self.pairs.get_mut(&link) {
            sockets[end_of(ends, at, interface)] = Socket::Closed;
        }
    }

    /// A descriptor is lost because its receiver has closed the connection.
    fn lose(&mut self, at: usize, link: LinkId) {
        if let Some(pair) = self.pairs.get_mut(&link) {
            pair.doomed = true;
            for (end, socket) in pair.ends.iter().zip(&mut pair.sockets) {
                if end.0 == at && *socket == Socket::Underway {
                    *socket = Socket::Closed;
                }
            }
        }
    }

    pub(crate) fn kill(&mut self, sent: usize) {
        if self.manager.take().is_none() {
            return;
        }
        for at in 0..NODES {
            self.programs[at].closed.clear();
            let Some(connection) = &mut self.programs[at].connection else {
                continue;
            };
            connection.up.clear();
            let keep = connection.down.len().min(sent);
            let lost = connection.down.split_off(keep);
            connection.down.push_back(Down::Eof);
            for frame in lost {
                if let Down::Frame(_, Some(link)) = frame {
                    self.lose(at, link);
                }
            }
        }
    }

    pub(crate) fn shutdown(&mut self) {
        if self.manager.is_some() {
            self.feed_manager(manager::Input::Shutdown);
            self.manager = None;
            for program in &mut self.programs {
                program.closed.clear();
                if let Some(connection) = &mut program.connection {
                    connection.up.clear();
                }
            }
        }
    }

    pub(crate) fn stall(&mut self, at: usize) {
        let Some(Connection { session, .. }) = self.programs[at].connection else {
            return;
        };
        if self.manager.is_some() {
            self.doom_underway(at, None);
            self.feed_manager(manager::Input::Stalled { session });
        }
    }

    /// Reads one datagram. Returns whether there was one.
    pub(crate) fn manager_reads(&mut self, at: usize) -> bool {
        if self.manager_reads_closed(at) {
            return true;
        }
        let Some(connection) = &self.programs[at].connection else {
            return false;
        };
        let session = connection.session;
        if connection.up.is_empty() {
            return false;
        }
        if self.is_busy(session) {
            return self.go_on();
        }
        let connection = self.programs[at].connection.as_mut();
        let Some(bytes) = connection.and_then(|it| it.up.pop_front()) else {
            return false;
        };
        self.feed_manager(manager::Input::Datagram {
            session,
            datagram: Datagram::new(&bytes),
        });
        true
    }

    /// Whether the Manager leaves the frames of a session unread (SM2-SES-009).
    fn is_busy(&self, session: NodeId) -> bool {
        self.manager.as_ref().is_some_and(|it| it.is_busy(session))
    }

    fn manager_reads_closed(&mut self, at: usize) -> bool {
        let Some(connection) = self.programs[at].closed.front() else {
            return false;
        };
        let session = connection.session;
        if self.is_busy(session) {
            return self.go_on();
        }
        let connection = self.programs[at].closed.front_mut();
        if let Some(bytes) = connection.and_then(|it| it.up.pop_front()) {
            self.feed_manager(manager::Input::Datagram {
                session,
                datagram: Datagram::new(&bytes),
            });
        } else {
            self.programs[at].closed.pop_front();
            self.doom_underway(at, None);
            self.feed_manager(manager::Input::Closed { session });
        }
        true
    }

    fn feed_manager(&mut self, input: manager::Input<'_>) {
        let Some(manager) = &mut self.manager else {
            return;
        };
        manager.handle(self.now, input).expect("sessions grow");
        let outputs: Vec<_> = std::iter::from_fn(|| manager.poll()).collect();
        let links = outputs.iter();
        let links = links.filter(|it| matches!(it, manager::Output::Link { .. }));
        let most = 2 * self.limits.count(Limit::LinksInFlight);
        assert!(links.count() <= most, "{outputs:?}");
        for output in outputs {
            match output {
                manager::Output::Send { session, frame } => {
                    self.send(session, Down::Frame(frame, None));
                }
                manager::Output::Link { link, ends } => self.link(link, ends),
                manager::Output::HangUp {
                    session,
                    goodbye,
                    cause,
                } => {
                    let violation = matches!(cause, Cause::Violation(_));
                    assert!(!violation, "{session}: {cause:?}");
                    if let Some(goodbye) = goodbye {
                        self.send(session, Down::Frame(goodbye, None));
                    }
                    self.send(session, Down::Eof);
                    if let Some(connection) = self.connection(session) {
                        connection.up.clear();
                    }
                }
                other @ (manager::Output::KeepCounters { .. }
                | manager::Output::SendCounters { .. }
                | manager::Output::ReadAccessPolicy) => panic!("nobody asks: {other:?}"),
            }
        }
    }

    /// The Manager does a part of its deferred work. Returns whether there was any.
    pub(crate) fn go_on(&mut self) -> bool {
        let deadline = self.manager.as_ref().and_then(Manager::deadline);
        let due = deadline.is_some_and(|due| due <= self.now);
        if due {
            self.feed_manager(manager::Input::Tick);
        }
        due
    }

    /// A node has read something. If it has read everything, the Manager is told.
    pub(super) fn drained(&mut self, at: usize) {
        if let (Some(connection), Some(manager)) = (&self.programs[at].connection, &self.manager)
            && connection.down.is_empty()
            && manager.awaits_room(connection.session)
        {
            let session = connection.session;
            self.feed_manager(manager::Input::Drained { session });
        }
    }

    fn connection(&mut self, session: NodeId) -> Option<&mut Connection> {
        let connections = self.programs.iter_mut().flat_map(|it| &mut it.connection);
        connections.into_iter().find(|it| it.session == session)
    }

    /// A datagram to a node that has closed its end is lost.
    fn send(&mut self, session: NodeId, down: Down) -> bool {
        let connection = self.connection(session);
        connection
            .map(|connection| connection.down.push_back(down))
            .is_some()
    }

    fn link(&mut self, link: LinkId, ends: [(NodeId, Vec<u8>); 2]) {
        let entities = ends.each_ref().map(|(session, frame)| {
            let facts = [FdFacts::default()];
            let datagram = Datagram {
                fds: &facts,
                ..Datagram::new(frame)
            };
            match decode_to_node(&datagram) {
                Ok(ToNode::Link { interface, .. }) => (*session, interface),
                other => panic!("{other:?} is no LINK"),
            }
        });
        let programs = &self.programs;
        let owner = |session: NodeId| {
            let of = |it: &Program| {
                let mut all = it.connection.iter().chain(&it.closed);
                all.any(|it| it.session == session)
            };
            programs.iter().position(of).expect("a session of ours")
        };
        let ours = entities.map(|(session, interface)| (owner(session), interface));
        // Its WITHDRAW is in flight.
        let is_withdrawn = |&(at, interface): &(usize, InterfaceId)| {
            !programs[at].interfaces.contains_key(&interface)
        };
        let pair = Pair {
            ends: ours,
            sockets: [Socket::Underway; 2],
            doomed: ours.iter().any(is_withdrawn),
        };
        assert!(self.pairs.insert(link, pair).is_none(), "{link} is new");
        for ((session, frame), (at, _)) in ends.into_iter().zip(ours) {
            if !self.send(session, Down::Frame(frame, Some(link))) {
                self.lose(at, link);
            }
        }
    }

    /// All nodes read and reconnect until nothing is left to do and every claim has come.
    pub(crate) fn run_until_quiet(&mut self) {
        self.start();
        loop {
            self.be_quiet();
            let Some(deadline) = self.manager.as_ref().and_then(Manager::deadline) else {
                return;
            };
            self.now = self.now.max(deadline);
            self.feed_manager(manager::Input::Tick);
        }
    }

    fn be_quiet(&mut self) {
        let mut busy = true;
        while busy {
            busy = false;
            for at in 0..NODES {
                self.reconnect(at);
                self.notice(at);
                busy |= self.manager_reads(at) | self.node_reads(at);
            }
            busy |= self.go_on();
        }
    }
}

fn end_of(ends: &[(usize, InterfaceId); 2], at: usize, interface: InterfaceId) -> usize {
    let ours = ends.iter().position(|end| *end == (at, interface));
    ours.expect("an end of the link")
}
