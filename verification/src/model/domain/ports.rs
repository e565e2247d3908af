//! The drivers: they feed the machines, carry out their outputs, and carry frames.

use std::rc::Rc;

use sm2_proto::{
    Code, Datagram, Farewell, FdFacts, InterfaceId, LinkId, Machine, NodeId, Refusal,
    control::{ToManager, ToNode, decode_to_manager, decode_to_node},
    manager::{self, Cause, Credentials},
    node::{self, End as SessionEnd},
};

use super::{
    super::Property,
    Fault, Scope,
    books::{Books, Side},
    faults,
    kept::Kept,
    program::{Connection, Down, End, Frame},
    world::{Pair, Socket, World},
};

const USER: Credentials = Credentials {
    uid: 1_000,
    gid: 1_000,
    pid: 1,
};

impl Connection {
    /// The Manager closes its end. Frames that it has not read are lost; frames that it has sent
    /// are not.
    pub(super) fn end(&mut self) {
        self.up.clear();
        self.books.manager_ends();
        if !self.dead {
            self.down.push_back(Down::Eof);
        }
        self.dead = true;
    }
}

impl World {
    pub(super) fn connect(&mut self, scope: &Scope, at: u8) {
        let mut session = self.next_session();
        if scope.fault == Some(Fault::SessionAgain) && self.sessions > 1 {
            self.sessions -= 1;
            session.0 -= 1;
        }
        let program = self.program(at);
        program.connection = Some(Connection {
            session,
            life: program.life,
            dead: false,
            resuming: false,
            up: [].into(),
            down: [].into(),
            books: Books::default(),
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

    /// Lets the Manager read. At most `limit` of the resulting frames are sent.
    pub(super) fn manager_reads(&mut self, scope: &Scope, at: u8, limit: usize) {
        let program = self.program(at);
        let first = program.closed.front_mut();
        let Some(connection) = first.or(program.connection.as_mut()) else {
            return;
        };
        let (session, life) = (connection.session, connection.life);
        if let Some(frame) = connection.up.pop_front() {
            match frame.says {
                ToManager::Hello { resuming, .. } => connection.resuming = resuming,
                ToManager::Claimed => connection.resuming = false,
                ToManager::Claim {
                    interface, link, ..
                } => connection.books.hear(Side::Manager, interface, link),
                ToManager::Unlinked {
                    interface, link, ..
                } => connection.books.read(Side::Manager, interface, link),
                _ => {}
            }
            let datagram = Datagram::new(&frame.bytes);
            self.feed_manager(scope, manager::Input::Datagram { session, datagram }, limit);
        } else {
            program.closed.pop_front();
            self.doom_all(|end| (end.0, end.1) == (at, life));
            self.feed_manager(scope, manager::Input::Closed { session }, limit);
        }
    }

    pub(super) fn feed_manager(&mut self, scope: &Scope, input: manager::Input<'_>, limit: usize) {
        let now = self.now;
        let manager = self.manager.as_mut().map(Rc::make_mut);
        let Some(manager) = manager.map(Kept::machine_mut) else {
            return;
        };
        let given_up = matches!(
            input,
            manager::Input::Stalled { .. } | manager::Input::Shutdown
        );
        let mut taken = manager.handle(now, input);
        if scope.fault == Some(Fault::Unpolled) {
            return;
        }
        let outputs: Vec<_> = std::iter::from_fn(|| manager.poll()).collect();
        // These sockets are never full, so no machine waits for room.
        for output in &outputs {
            if let manager::Output::Link { ends, .. } = output {
                for &(session, _) in ends {
                    taken = taken.and(manager.handle(now, manager::Input::Drained { session }));
                }
            }
        }
        if let Err(error) = taken {
            self.fail(Property::Invariants, error);
        }
        let mut left = limit;
        for output in outputs {
            match output {
                manager::Output::Send { session, frame } => {
                    if left > 0 {
                        left -= 1;
                        self.send_down(scope, session, frame, None);
                    }
                }
                manager::Output::Link { link, ends } => {
                    if scope.fault == Some(Fault::LinkTwice) {
                        self.link(scope, link, ends.clone(), &mut left);
                    }
                    self.link(scope, link, ends, &mut left);
                }
                manager::Output::HangUp {
                    cause: Cause::Gone, ..
                } => {}
                manager::Output::HangUp {
                    session,
                    goodbye,
                    cause: Cause::Farewell(_),
                } if given_up => self.manager_hangs_up(scope, session, goodbye),
                other => self.fail(Property::ManagerAccusesNobody, format_args!("{other:?}")),
            }
        }
    }

    fn manager_hangs_up(&mut self, scope: &Scope, session: NodeId, goodbye: Option<Vec<u8>>) {
        if let Some(goodbye) = goodbye {
            self.send_down(scope, session, goodbye, None);
        }
        if let Some((_, connection)) = self.connection(session) {
            connection.end();
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

    /// Sends a frame to a node; it is lost if the node has closed its end.
    fn send_down(
        &mut self,
        scope: &Scope,
        session: NodeId,
        bytes: Vec<u8>,
        link: Option<(LinkId, InterfaceId)>,
    ) {
        let Some(says) = decode_down(&bytes, link.is_some()) else {
            return self.fail(
                Property::NodeAccusesNobody,
                "a frame that cannot be decoded",
            );
        };
        let Some((at, connection)) = self.connection(session) else {
            return;
        };
        let books = &mut connection.books;
        let wrong = match says {
            ToNode::Link {
                interface, link, ..
            } => books.name(Side::Manager, interface, link),
            ToNode::Unlink {
                interface, link, ..
            } => books.farewell(Side::Manager, interface, link),
            ToNode::Withdrawn { interface } => {
                books.forget(interface);
                None
            }
            _ => None,
        };
        let frame = Frame { bytes, says };
        faults::send_down(scope.fault, frame, link, &mut connection.down);
        if let Some(wrong) = wrong {
            let what = format!("the Manager to node {at}: {wrong}");
            self.fail(Property::OneFarewell, what);
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
            let Some(ToNode::Link { interface, key, .. }) = decode_down(frame, true) else {
                return self.fail(Property::NodeAccusesNobody, "LINK without a LINK");
            };
            Rc::make_mut(&mut self.keys).insert(link, key.0);
            *place = self.owner(*session, interface);
        }
        // The WITHDRAW of one of them, or the end of its process, may be in flight.
        let stays = |(at, life, interface): End| {
            let program = self.programs.get(usize::from(at));
            program.is_some_and(|it| it.life == life && it.interfaces.contains_key(&interface))
        };
        let manager = self.manager.as_ref().map(|it| it.machine());
        let is_undecided = (self.policy).is_undecided(scope, &self.programs, manager, &places);
        let pair = Pair {
            ends: places,
            sockets: [Socket::Underway; 2],
            doomed: !places.into_iter().all(stays) || is_undecided,
        };
        self.pairs.insert(link, pair);
        for ((session, frame), end) in ends.into_iter().zip(places) {
            if *left > 0 && self.connection(session).is_some() {
                *left -= 1;
                self.send_down(scope, session, frame, Some((link, end.2)));
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
        let Some(connection) = self.program(at).connection.as_mut() else {
            return;
        };
        match connection.down.pop_front() {
            None => {}
            Some(Down::Eof) => self.feed_node(scope, at, node::Input::Eof, None),
            Some(Down::Frame(frame, link)) => {
                match frame.says {
                    ToNode::Link {
                        interface, link, ..
                    } => connection.books.hear(Side::Node, interface, link),
                    ToNode::Unlink {
                        interface, link, ..
                    } => connection.books.read(Side::Node, interface, link),
                    _ => {}
                }
                let facts = link.map(|_| FdFacts::default());
                let datagram = Datagram {
                    fds: facts.as_slice(),
                    ..Datagram::new(&frame.bytes)
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
                node::Output::Transmit(bytes) => self.send_up(scope, at, bytes),
                node::Output::Welcomed { .. } => {
                    // A program that reconnects has declared before.
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
                } => self.end_at_node(at, interface, link, code),
                node::Output::Ended(end) => {
                    if matches!(end, SessionEnd::Violation(_) | SessionEnd::Local(_)) {
                        self.fail(Property::NodeAccusesNobody, end);
                    }
                    self.hang_up(at);
                }
                node::Output::DeclareRefused {
                    interface,
                    reason: Refusal::Denied { .. } | Refusal::Exclusive { .. },
                } => self.refused(at, interface),
                node::Output::Declared { interface, .. } => {
                    self.program(at).live.insert(interface);
                }
                node::Output::Withdrawn { .. }
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

    /// The access policy denies an interface. One that was live before stays.
    fn refused(&mut self, at: u8, interface: InterfaceId) {
        let program = self.program(at);
        if !program.live.contains(&interface)
            && let Some(place) = program.interfaces.remove(&interface)
        {
            program.refused.insert(place);
        }
    }

    fn end_at_node(&mut self, at: u8, interface: InterfaceId, link: LinkId, code: Code) {
        if self.pairs.get(&link).is_some_and(|pair| !pair.doomed) {
            let what = format!("{link} was ended for nothing: {code}");
            self.fail(Property::LinksSurvive, what);
        }
        // A node that has ended a link is told that the policy denies it, all the same.
        if code != Farewell::Denied.code() {
            self.check_known(at, interface, link, "is told to end");
        }
        self.close_end(at, interface, link);
    }

    fn check_known(&mut self, at: u8, interface: InterfaceId, link: LinkId, what: &str) {
        if !self.program(at).links.contains(&(interface, link)) {
            let what = format!("node {at} {what} {link}, which it has not");
            self.fail(Property::KnowsItsLinks, what);
        }
    }

    //= SM2-IFC-004, SM2-RES-002 model
    fn send_up(&mut self, scope: &Scope, at: u8, bytes: Vec<u8>) {
        let Ok(says) = decode_to_manager(&Datagram::new(&bytes)) else {
            return self.fail(
                Property::ManagerAccusesNobody,
                "a frame that cannot be decoded",
            );
        };
        if let ToManager::Claim {
            interface, link, ..
        } = says
        {
            self.check_known(at, interface, link, "claims");
        }
        let program = self.program(at);
        let Some(connection) = program.connection.as_mut() else {
            return;
        };
        let wrong = match says {
            ToManager::Unlinked {
                interface, link, ..
            } => {
                let live = program.interfaces.contains_key(&interface);
                let wrong = (connection.books).farewell(Side::Node, interface, link);
                let dropped = || (!live).then(|| format!("{interface} is withdrawn"));
                wrong.or_else(dropped)
            }
            ToManager::Claim {
                interface, link, ..
            } => connection.books.name(Side::Node, interface, link),
            _ => None,
        };
        if !connection.dead {
            let frame = faults::send_up(scope.fault, Frame { bytes, says }, at);
            connection.up.extend(frame.map(Rc::new));
        }
        if let Some(wrong) = wrong {
            let what = format!("node {at} to the Manager: {wrong}");
            self.fail(Property::OneFarewell, what);
        }
    }
}

fn decode_down(frame: &[u8], link: bool) -> Option<ToNode> {
    let facts = link.then(FdFacts::default);
    let datagram = Datagram {
        fds: facts.as_slice(),
        ..Datagram::new(frame)
    };
    decode_to_node(&datagram).ok()
}
