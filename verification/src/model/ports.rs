//! What drivers do: feed machines, carry out their outputs, carry frames.

use std::rc::Rc;

use sm2_proto::{
    Code, Datagram, FdFacts, InterfaceId, LinkId, NodeId,
    control::{
        ToManager, ToNode, decode_to_manager, decode_to_node, encode_to_manager, encode_to_node,
    },
    manager::{self, Cause, Credentials, Manager},
    node::{self, End as SessionEnd},
};

use super::{
    Fault, Property, Scope,
    world::{Connection, Down, End, Pair, Socket, World},
};

const USER: Credentials = Credentials {
    uid: 1_000,
    gid: 1_000,
    pid: 1,
};

impl World {
    pub(super) fn connect(&mut self, scope: &Scope, at: u8) {
        self.sessions += 1;
        let session = NodeId(self.sessions);
        let program = self.program(at);
        program.connection = Some(Connection {
            session,
            life: program.life,
            dead: false,
            up: [].into(),
            down: [].into(),
            ends: [].into(),
        });
        let begun = std::mem::replace(&mut program.begun, true);
        let connected = manager::Input::Connected {
            session,
            credentials: USER,
        };
        self.feed_manager(scope, connected, usize::MAX);
        if begun {
            self.feed_node(scope, at, node::Input::Reconnected, None);
        } else {
            self.node_works(scope, at, None);
        }
    }

    /// The Manager sends no more than `limit` frames of what follows.
    pub(super) fn manager_reads(&mut self, scope: &Scope, at: u8, limit: usize) {
        let program = self.program(at);
        let first = program.closed.front_mut();
        let Some(connection) = first.or(program.connection.as_mut()) else {
            return;
        };
        let (session, life) = (connection.session, connection.life);
        if let Some(bytes) = connection.up.pop_front() {
            let datagram = Datagram::new(&bytes);
            self.feed_manager(scope, manager::Input::Datagram { session, datagram }, limit);
        } else {
            program.closed.pop_front();
            self.doom_all(|end| (end.0, end.1) == (at, life));
            self.feed_manager(scope, manager::Input::Closed { session }, limit);
        }
    }

    /// How many frames the Manager would send upon what a node sent.
    pub(super) fn frames_of_answer(&self, at: u8) -> u8 {
        let program = &self.programs[usize::from(at)];
        let connection = program.closed.front().or(program.connection.as_ref());
        let (Some(connection), Some(manager)) = (connection, &self.manager) else {
            return 0;
        };
        let session = connection.session;
        let mut manager = Manager::clone(manager);
        let input = match connection.up.front() {
            Some(bytes) => manager::Input::Datagram {
                session,
                datagram: Datagram::new(bytes),
            },
            None => manager::Input::Closed { session },
        };
        if manager.handle(self.now, input).is_err() {
            return 0;
        }
        let frames = std::iter::from_fn(|| manager.poll()).map(|output| match output {
            manager::Output::Link { .. } => 2,
            manager::Output::Send { .. } => 1,
            _ => 0,
        });
        frames.sum()
    }

    pub(super) fn feed_manager(&mut self, scope: &Scope, input: manager::Input<'_>, limit: usize) {
        let now = self.now;
        let Some(manager) = self.manager.as_mut().map(Rc::make_mut) else {
            return;
        };
        let taken = manager.handle(now, input);
        let outputs: Vec<_> = std::iter::from_fn(|| manager.poll()).collect();
        if let Err(error) = taken {
            self.fail(Property::Invariants, error);
        }
        let mut left = limit;
        for output in outputs {
            match output {
                manager::Output::Send { session, frame } => {
                    if left > 0 {
                        left -= 1;
                        self.send_down(scope, session, &frame, None);
                    }
                }
                manager::Output::Link { link, ends } => self.link(scope, link, ends, &mut left),
                manager::Output::HangUp {
                    cause: Cause::Gone, ..
                } => {}
                other => self.fail(Property::ManagerAccusesNobody, format_args!("{other:?}")),
            }
        }
    }

    fn connection(&mut self, session: NodeId) -> Option<(u8, &mut Connection)> {
        let current = |it: &Connection| it.session == session && !it.dead;
        let programs = (0_u8..).zip(&self.programs);
        let mut mine = programs.filter(|(_, it)| it.connection.as_ref().is_some_and(current));
        let (at, _) = mine.next()?;
        let connection = self.program(at).connection.as_mut()?;
        Some((at, connection))
    }

    /// What is sent to a node that has closed its end is lost.
    fn send_down(
        &mut self,
        scope: &Scope,
        session: NodeId,
        frame: &[u8],
        link: Option<(LinkId, InterfaceId)>,
    ) {
        let Some(decoded) = decode_down(frame, link.is_some()) else {
            return self.fail(
                Property::NodeAccusesNobody,
                "a frame that cannot be decoded",
            );
        };
        let Some((at, connection)) = self.connection(session) else {
            return;
        };
        let mut wrong = None;
        match &decoded {
            ToNode::Link {
                interface, link, ..
            } => drop(connection.ends.insert((*interface, *link), [false; 2])),
            ToNode::Unlink {
                interface, link, ..
            } => wrong = farewell(connection, *interface, *link, 0),
            ToNode::Withdrawn { interface } => {
                connection.ends.retain(|(of, _), _| of != interface);
            }
            _ => {}
        }
        let mut bytes = Rc::from(frame);
        let mut first = false;
        let mut twice = false;
        match (scope.fault, decoded) {
            (Some(Fault::WithdrawnOvertakes), ToNode::Withdrawn { .. }) => first = true,
            (Some(Fault::DeclaredTwice), ToNode::Declared { .. }) => twice = true,
            (Some(Fault::OtherTerms), ToNode::Link { .. }) => {
                bytes = other_terms(frame);
            }
            _ => {}
        }
        let down = Down::Frame(bytes, link);
        if twice {
            connection.down.push_back(down.clone());
        }
        if first {
            connection.down.push_front(down);
        } else {
            connection.down.push_back(down);
        }
        if let Some(wrong) = wrong {
            self.fail(
                Property::OneFarewell,
                format_args!("UNLINK to node {at}: {wrong}"),
            );
        }
    }

    fn link(
        &mut self,
        scope: &Scope,
        link: LinkId,
        ends: [(NodeId, Vec<u8>); 2],
        left: &mut usize,
    ) {
        if self.last_link.is_some_and(|last| link <= last) {
            return self.fail(Property::FreshIds, format_args!("{link} comes again"));
        }
        self.last_link = Some(link);
        let mut places = [(0, 0, InterfaceId(0)); 2];
        for ((session, frame), place) in ends.iter().zip(&mut places) {
            let Some(ToNode::Link { interface, .. }) = decode_down(frame, true) else {
                return self.fail(Property::NodeAccusesNobody, "LINK without a LINK");
            };
            *place = self.owner(*session, interface);
        }
        // The WITHDRAW of one of them, or its process' end, may be on the way.
        let stays = |(at, life, interface): End| {
            let program = self.programs.get(usize::from(at));
            program.is_some_and(|it| it.life == life && it.interfaces.contains_key(&interface))
        };
        let pair = Pair {
            ends: places,
            sockets: [Socket::Underway; 2],
            doomed: !places.into_iter().all(stays),
        };
        self.pairs.insert(link, pair);
        for ((session, frame), end) in ends.into_iter().zip(places) {
            if *left > 0 && self.connection(session).is_some() {
                *left -= 1;
                self.send_down(scope, session, &frame, Some((link, end.2)));
            } else {
                *left = left.saturating_sub(1);
                self.lose(end, link);
            }
        }
    }

    fn owner(&self, session: NodeId, interface: InterfaceId) -> End {
        for (at, program) in (0_u8..).zip(&self.programs) {
            let open = program.connection.iter().filter(|it| !it.dead);
            for connection in open.chain(&program.closed) {
                if connection.session == session {
                    return (at, connection.life, interface);
                }
            }
        }
        (u8::MAX, 0, interface)
    }

    pub(super) fn node_reads(&mut self, scope: &Scope, at: u8) {
        let connection = self.program(at).connection.as_mut();
        match connection.and_then(|it| it.down.pop_front()) {
            None => {}
            Some(Down::Eof) => self.feed_node(scope, at, node::Input::Eof, None),
            Some(Down::Frame(bytes, link)) => {
                let facts = link.map(|_| FdFacts::default());
                let datagram = Datagram {
                    fds: facts.as_slice(),
                    ..Datagram::new(&bytes)
                };
                self.feed_node(scope, at, node::Input::Datagram(datagram), link);
            }
        }
    }

    pub(super) fn say_unlinked(
        &mut self,
        scope: &Scope,
        at: u8,
        interface: InterfaceId,
        link: LinkId,
        code: Code,
    ) {
        let unlinked = node::Input::Unlinked {
            interface,
            link,
            code,
        };
        self.feed_node(scope, at, unlinked, None);
    }

    pub(super) fn feed_node(
        &mut self,
        scope: &Scope,
        at: u8,
        input: node::Input<'_>,
        link: Option<(LinkId, InterfaceId)>,
    ) {
        let now = self.now;
        if let Err(error) = self.program(at).node.handle(now, input) {
            let what = format!("node {at}: {error}");
            return self.fail(Property::NodeAccusesNobody, what);
        }
        self.node_works(scope, at, link);
    }

    /// `descriptor` came with the datagram just handled.
    pub(super) fn node_works(
        &mut self,
        scope: &Scope,
        at: u8,
        mut descriptor: Option<(LinkId, InterfaceId)>,
    ) {
        while let Some(output) = self.program(at).node.poll() {
            match output {
                node::Output::Transmit(bytes) => self.send_up(scope, at, &bytes),
                node::Output::Welcomed { .. } => {
                    // A program that comes back has declared before.
                    let first = self.program(at).interfaces.is_empty();
                    while scope.eager && first && !self.program(at).undeclared.is_empty() {
                        self.declare(scope, at);
                    }
                }
                node::Output::Linked {
                    interface, link, ..
                } => {
                    descriptor = None;
                    let program = self.program(at);
                    program.links.insert((interface, link));
                    let end = (at, program.life, interface);
                    self.set_socket(link, |it| *it == end, Socket::Held);
                }
                node::Output::Unlink {
                    interface,
                    link,
                    code,
                } => {
                    if self.pairs.get(&link).is_some_and(|pair| !pair.doomed) {
                        let what = format!("{link} was ended for nothing: {code}");
                        self.fail(Property::LinksSurvive, what);
                    }
                    self.close_end(at, interface, link);
                }
                node::Output::Ended(end) => {
                    if matches!(end, SessionEnd::Violation(_) | SessionEnd::Local(_)) {
                        self.fail(Property::NodeAccusesNobody, end);
                    }
                    self.hang_up(at);
                }
                node::Output::Declared { .. }
                | node::Output::Withdrawn { .. }
                | node::Output::Resumed
                | node::Output::HelloRefused(_) => {}
                other => self.fail(Property::Converges, format_args!("node {at}: {other:?}")),
            }
        }
        // A LINK that crossed WITHDRAW: the driver closes the descriptor.
        if let Some((link, interface)) = descriptor {
            let life = self.program(at).life;
            self.lose((at, life, interface), link);
        }
    }

    fn send_up(&mut self, scope: &Scope, at: u8, frame: &[u8]) {
        let Ok(decoded) = decode_to_manager(&Datagram::new(frame)) else {
            return self.fail(
                Property::ManagerAccusesNobody,
                "a frame that cannot be decoded",
            );
        };
        let Some(connection) = self.program(at).connection.as_mut() else {
            return;
        };
        let mut wrong = None;
        match decoded {
            ToManager::Unlinked {
                interface, link, ..
            } => wrong = farewell(connection, interface, link, 1),
            ToManager::Claim {
                interface, link, ..
            } => drop(connection.ends.insert((interface, link), [false; 2])),
            _ => {}
        }
        let bytes = match (scope.fault, decoded) {
            (Some(Fault::UnlinkedLost), ToManager::Unlinked { .. })
            | (Some(Fault::ClaimedLost), ToManager::Claimed) => None,
            (Some(Fault::OtherKey), claim @ ToManager::Claim { .. }) => Some(other_key(claim, at)),
            _ => Some(Rc::from(frame)),
        };
        if !connection.dead {
            connection.up.extend(bytes);
        }
        if let Some(wrong) = wrong {
            self.fail(
                Property::OneFarewell,
                format_args!("UNLINKED of node {at}: {wrong}"),
            );
        }
    }
}

/// Notes a farewell of one side (0 the Manager, 1 the node); what is wrong with it, if anything.
//= SM2-LNK-003 model
fn farewell(
    connection: &mut Connection,
    interface: InterfaceId,
    link: LinkId,
    side: usize,
) -> Option<String> {
    let said = connection.ends.get_mut(&(interface, link));
    let Some(said) = said.filter(|said| !said[side]) else {
        return Some(format!(
            "{link} of {interface} has no such farewell to come"
        ));
    };
    said[side] = true;
    if *said == [true; 2] {
        connection.ends.remove(&(interface, link));
    }
    None
}

fn decode_down(frame: &[u8], link: bool) -> Option<ToNode> {
    let facts = link.then(FdFacts::default);
    let datagram = Datagram {
        fds: facts.as_slice(),
        ..Datagram::new(frame)
    };
    decode_to_node(&datagram).ok()
}

fn other_terms(frame: &[u8]) -> Rc<[u8]> {
    let mut decoded = decode_down(frame, true);
    if let Some(ToNode::Link { reliable, .. }) = &mut decoded {
        *reliable = !*reliable;
    }
    decoded.map_or_else(|| Rc::from(frame), |it| encode_to_node(&it).into())
}

fn other_key(mut claim: ToManager, at: u8) -> Rc<[u8]> {
    if let ToManager::Claim { key, .. } = &mut claim {
        *key ^= u64::from(at);
    }
    encode_to_manager(&claim).into()
}
