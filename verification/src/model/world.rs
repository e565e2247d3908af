//! One moment of a domain: machines, frames in flight, ends of links. No kernel, no clock.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    fmt,
    rc::Rc,
};

use sm2_proto::{
    Code, Farewell, Instant, InterfaceId, LinkId, Name, NodeId,
    manager::{self, Manager, Policy},
    node::{self, Node},
};

use super::{Action, Budget, Failure, Fault, Property, Scope};

/// When each Manager begins: time is as it were at rest, and moves on by deadlines alone.
const BEGIN: Instant = Instant(1);

/// An interface of one process: which node, its how manieth process, which interface.
pub(super) type End = (u8, u8, InterfaceId);

/// Where one end of a link's socket pair is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Socket {
    Underway,
    Held,
    Closed,
}

/// A link's two ends. Forgotten as soon as both are closed.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Pair {
    pub(super) ends: [End; 2],
    pub(super) sockets: [Socket; 2],
    /// Whether anybody had reason to end it.
    pub(super) doomed: bool,
}

/// What a node has still to read.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Down {
    /// With the descriptor of a link, for this interface.
    Frame(Rc<[u8]>, Option<(LinkId, InterfaceId)>),
    Eof,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Connection {
    pub(super) session: NodeId,
    /// Which process of the node's.
    pub(super) life: u8,
    /// The Manager's end is gone.
    pub(super) dead: bool,
    pub(super) up: VecDeque<Rc<[u8]>>,
    pub(super) down: VecDeque<Down>,
    /// The ends of links of this session that lack a farewell: from the Manager, from the node.
    pub(super) ends: BTreeMap<(InterfaceId, LinkId), [bool; 2]>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Program {
    pub(super) node: Node,
    pub(super) life: u8,
    /// Whether this process has connected before.
    pub(super) begun: bool,
    pub(super) connection: Option<Connection>,
    /// Connections that the node has closed and the Manager has not read to their end.
    pub(super) closed: VecDeque<Connection>,
    /// Which contract each interface has, and which have none yet, as places in the scope's list.
    pub(super) interfaces: BTreeMap<InterfaceId, u8>,
    pub(super) undeclared: BTreeSet<u8>,
    pub(super) links: BTreeSet<(InterfaceId, LinkId)>,
}

/// One moment.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct World {
    pub(super) now: Instant,
    pub(super) epoch: u64,
    pub(super) sessions: u64,
    pub(super) last_link: Option<LinkId>,
    pub(super) manager: Option<Rc<Manager>>,
    pub(super) programs: Vec<Rc<Program>>,
    pub(super) pairs: BTreeMap<LinkId, Pair>,
    /// Pairs that the present Manager may keep apart, since one of them ended its link.
    pub(super) broken: BTreeSet<[End; 2]>,
    pub(super) budget: Budget,
    /// What went wrong in the step that led here; no such moment is gone on from.
    pub(super) failure: Option<Failure>,
}

impl Program {
    fn new(at: usize, life: u8, scope: &Scope) -> Self {
        let name = Name::new(&format!("node/{at}")).expect("a legal name");
        Self {
            node: Node::new(name),
            life,
            begun: false,
            connection: None,
            closed: VecDeque::new(),
            interfaces: BTreeMap::new(),
            undeclared: (0_u8..).take(scope.programs[at].len()).collect(),
            links: BTreeSet::new(),
        }
    }
}

impl World {
    /// The first moment of a scope.
    ///
    /// # Errors
    ///
    /// What breaks on the way there.
    pub fn new(scope: &Scope) -> Result<Self, Failure> {
        let programs = 0..scope.programs.len();
        let mut world = Self {
            now: BEGIN,
            epoch: 0,
            sessions: 0,
            last_link: None,
            manager: None,
            programs: programs
                .map(|at| Rc::new(Program::new(at, 0, scope)))
                .collect(),
            pairs: BTreeMap::new(),
            broken: BTreeSet::new(),
            budget: scope.budget,
            failure: None,
        };
        world.begin(scope);
        if scope.settled {
            while let Some(&action) = world.progress().first() {
                world = world.step(scope, action)?;
            }
        }
        Ok(world)
    }

    /// All that can happen now.
    #[must_use]
    pub fn actions(&self, scope: &Scope) -> Vec<Action> {
        let mut actions = self.progress();
        if self.nothing_ends_any_more(scope) {
            let read = |it: &&Action| matches!(it, Action::NodeReads(_));
            if let Some(&first) = actions.iter().find(read) {
                return vec![first];
            }
        }
        self.add_choices(scope, &mut actions);
        actions
    }

    /// Whether neither a process nor the Manager dies any more, and no link has an end to come.
    /// Then what a node reads changes nothing but that node and what it sends, whatever else
    /// happens before or after: one order of it stands for all of them.
    fn nothing_ends_any_more(&self, scope: &Scope) -> bool {
        scope.eager
            && scope.budget.withdrawals == 0
            && scope.budget.closes == 0
            && self.budget == Budget::default()
            && self.pairs.values().all(|pair| !pair.doomed)
            && self.programs.iter().all(|it| it.closed.is_empty())
    }

    /// What happens by itself, sooner or later.
    pub(super) fn progress(&self) -> Vec<Action> {
        let mut actions = Vec::new();
        let alive = self.manager.is_some();
        if !alive {
            actions.push(Action::ManagerBegins);
        }
        for (at, program) in (0_u8..).zip(&self.programs) {
            let open = program.connection.as_ref();
            if alive && (!program.closed.is_empty() || open.is_some_and(|it| !it.up.is_empty())) {
                actions.push(Action::ManagerReads(at));
            }
            if open.is_some_and(|it| !it.down.is_empty()) {
                actions.push(Action::NodeReads(at));
            }
            // A Manager hears those who are gone before those who come.
            if alive && open.is_none() && program.closed.is_empty() {
                actions.push(Action::Connects(at));
            }
            for &(interface, link) in &program.links {
                let pair = &self.pairs[&link];
                let ours = end_of(&pair.ends, (at, program.life, interface));
                if pair.sockets[1 - ours] == Socket::Closed {
                    actions.push(Action::Notices(at, interface, link));
                }
            }
        }
        let deadline = self.manager.as_ref().and_then(|it| it.deadline());
        if actions.is_empty() && deadline.is_some() {
            actions.push(Action::TimePasses);
        }
        actions
    }

    /// What may happen, within the budget.
    fn add_choices(&self, scope: &Scope, actions: &mut Vec<Action>) {
        for (at, program) in (0_u8..).zip(&self.programs) {
            if !scope.eager && !program.undeclared.is_empty() && self.can_declare(at) {
                actions.push(Action::Declares(at));
            }
            if self.budget.withdrawals > 0 {
                for &interface in program.interfaces.keys() {
                    let withdraw = node::Input::Withdraw { interface };
                    // Not while it is being declared.
                    if program.node.clone().handle(self.now, withdraw).is_ok() {
                        actions.push(Action::Withdraws(at, interface));
                    }
                }
            }
            if self.budget.closes > 0 {
                let links = program.links.iter();
                actions.extend(links.map(|&(interface, link)| Action::Closes(at, interface, link)));
            }
            if self.budget.node_crashes > 0 && program.begun {
                actions.push(Action::NodeDies(at));
            }
        }
        if self.budget.manager_crashes > 0 && self.manager.is_some() {
            actions.push(Action::ManagerDies);
            for (at, program) in (0_u8..).zip(&self.programs) {
                let open = program.connection.as_ref();
                if !program.closed.is_empty() || open.is_some_and(|it| !it.up.is_empty()) {
                    let frames = self.frames_of_answer(at);
                    actions.extend((1..frames).map(|sent| Action::ManagerDiesAnswering(at, sent)));
                }
            }
        }
    }

    fn can_declare(&self, at: u8) -> bool {
        let mut node = self.programs[usize::from(at)].node.clone();
        // Without a WELCOME no interface can be withdrawn either, whatever its number.
        !matches!(
            node.handle(
                self.now,
                node::Input::Withdraw {
                    interface: InterfaceId(0)
                }
            ),
            Err(node::Error::Misuse(node::Misuse::NotReady) | node::Error::Ended(_))
        )
    }

    /// The moment after `action`, which is one of [`World::actions`].
    ///
    /// # Errors
    ///
    /// What this broke.
    pub fn step(&self, scope: &Scope, action: Action) -> Result<Self, Failure> {
        let mut next = self.clone();
        match action {
            Action::ManagerReads(at) => next.manager_reads(scope, at, usize::MAX),
            Action::NodeReads(at) => next.node_reads(scope, at),
            Action::Connects(at) => next.connect(scope, at),
            Action::Notices(at, interface, link) => next.notice(scope, at, interface, link),
            Action::ManagerBegins => next.begin(scope),
            Action::TimePasses => {
                let deadline = next.manager.as_ref().and_then(|it| it.deadline());
                next.now = deadline.unwrap_or(next.now);
                next.feed_manager(scope, manager::Input::Tick, usize::MAX);
            }
            Action::Declares(at) => {
                next.declare(scope, at);
                next.node_works(scope, at, None);
            }
            Action::Withdraws(at, interface) => next.withdraw(scope, at, interface),
            Action::Closes(at, interface, link) => {
                next.budget.closes -= 1;
                next.doom(link);
                let mut ends = next.pairs[&link].ends;
                ends.sort_unstable();
                next.broken.insert(ends);
                next.close_end(at, interface, link);
                next.say_unlinked(scope, at, interface, link, Code(71));
            }
            Action::NodeDies(at) => next.node_dies(scope, at),
            Action::ManagerDies => next.manager_dies(),
            Action::ManagerDiesAnswering(at, sent) => {
                next.manager_reads(scope, at, usize::from(sent));
                next.manager_dies();
            }
        }
        match next.failure.take() {
            Some(failure) => Err(failure),
            None => Ok(next),
        }
    }

    pub(super) fn program(&mut self, at: u8) -> &mut Program {
        Rc::make_mut(&mut self.programs[usize::from(at)])
    }

    pub(super) fn fail(&mut self, property: Property, what: impl fmt::Display) {
        let what = what.to_string();
        self.failure.get_or_insert(Failure { property, what });
    }

    fn begin(&mut self, scope: &Scope) {
        if scope.fault != Some(Fault::EpochAgain) || self.epoch == 0 {
            self.epoch += 1;
        }
        // Changes are not asked for here; pages are.
        let policy = Policy {
            changes_remembered: 0,
            ..Policy::default()
        };
        self.manager = Some(Rc::new(Manager::new(self.epoch, 7, policy)));
        self.sessions = 0;
        self.now = BEGIN;
        self.broken.clear();
    }

    pub(super) fn declare(&mut self, scope: &Scope, at: u8) {
        let program = self.program(at);
        let Some(place) = program.undeclared.pop_first() else {
            return;
        };
        let contract = scope.programs[usize::from(at)][usize::from(place)].clone();
        match program.node.declare(contract) {
            Ok(interface) => drop(program.interfaces.insert(interface, place)),
            Err(error) => self.fail(Property::Invariants, error),
        }
    }

    fn withdraw(&mut self, scope: &Scope, at: u8, interface: InterfaceId) {
        self.budget.withdrawals -= 1;
        let program = self.program(at);
        let life = program.life;
        if let Some(place) = program.interfaces.remove(&interface) {
            program.undeclared.insert(place);
        }
        let links: Vec<_> = program.links.iter().copied().collect();
        self.doom_all(|end| *end == (at, life, interface));
        for (_, link) in links.into_iter().filter(|(of, _)| *of == interface) {
            self.close_end(at, interface, link);
        }
        self.broken
            .retain(|ends| !ends.contains(&(at, life, interface)));
        self.feed_node(scope, at, node::Input::Withdraw { interface }, None);
        if scope.eager {
            self.declare(scope, at);
            self.node_works(scope, at, None);
        }
    }

    fn notice(&mut self, scope: &Scope, at: u8, interface: InterfaceId, link: LinkId) {
        self.close_end(at, interface, link);
        let code = Farewell::PeerGone.code();
        self.say_unlinked(scope, at, interface, link, code);
    }

    fn node_dies(&mut self, scope: &Scope, at: u8) {
        self.budget.node_crashes -= 1;
        let life = self.programs[usize::from(at)].life;
        self.doom_all(|end| (end.0, end.1) == (at, life));
        self.broken
            .retain(|ends| !ends.iter().any(|end| (end.0, end.1) == (at, life)));
        self.hang_up(at);
        for (interface, link) in self.program(at).links.clone() {
            self.close_end(at, interface, link);
        }
        let closed = std::mem::take(&mut self.program(at).closed);
        *self.program(at) = Program::new(usize::from(at), life + 1, scope);
        self.program(at).closed = closed;
        if scope.fault == Some(Fault::EndUnseen) {
            self.program(at).closed.clear();
        }
    }

    /// A node closes its end of its connection: what it has not read is lost.
    pub(super) fn hang_up(&mut self, at: u8) {
        let Some(mut connection) = self.program(at).connection.take() else {
            return;
        };
        for down in std::mem::take(&mut connection.down) {
            if let Down::Frame(_, Some((link, interface))) = down {
                self.lose((at, connection.life, interface), link);
            }
        }
        if !connection.dead {
            // What farewells are still to come nobody will see.
            connection.ends.clear();
            self.program(at).closed.push_back(connection);
        }
    }

    fn manager_dies(&mut self) {
        self.budget.manager_crashes -= 1;
        self.manager = None;
        for program in self.programs.iter_mut().map(Rc::make_mut) {
            program.closed.clear();
            if let Some(connection) = &mut program.connection {
                connection.up.clear();
                if !connection.dead {
                    connection.down.push_back(Down::Eof);
                }
                connection.dead = true;
            }
        }
    }

    pub(super) fn doom(&mut self, link: LinkId) {
        if let Some(pair) = self.pairs.get_mut(&link) {
            pair.doomed = true;
        }
    }

    pub(super) fn doom_all(&mut self, touched: impl Fn(&End) -> bool) {
        for pair in self.pairs.values_mut() {
            pair.doomed |= pair.ends.iter().any(&touched);
        }
    }

    pub(super) fn close_end(&mut self, at: u8, interface: InterfaceId, link: LinkId) {
        let program = self.program(at);
        program.links.remove(&(interface, link));
        let end = (at, program.life, interface);
        self.set_socket(link, |it| *it == end, Socket::Closed);
    }

    /// A descriptor that nobody received.
    pub(super) fn lose(&mut self, end: End, link: LinkId) {
        self.doom(link);
        self.set_socket(link, |it| *it == end, Socket::Closed);
    }

    pub(super) fn set_socket(
        &mut self,
        link: LinkId,
        which: impl FnMut(&End) -> bool,
        socket: Socket,
    ) {
        let Some(pair) = self.pairs.get_mut(&link) else {
            return;
        };
        if let Some(place) = pair.ends.iter().position(which) {
            pair.sockets[place] = socket;
        }
        if pair.sockets == [Socket::Closed; 2] {
            let doomed = pair.doomed;
            self.pairs.remove(&link);
            if !doomed {
                self.fail(
                    Property::LinksSurvive,
                    format_args!("{link} was lost for nothing"),
                );
            }
        }
    }
}

pub(super) fn end_of(ends: &[End; 2], end: End) -> usize {
    usize::from(ends[0] != end)
}
