//! One moment of a domain: machines, frames in flight, ends of links. No kernel, no clock.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    fmt,
    hash::{Hash, Hasher},
    rc::Rc,
};

use sm2_proto::{
    Instant, InterfaceId, LinkId, Machine, Name, NodeId,
    control::{ToManager, ToNode},
    node::{Input, Node},
};

use super::{
    super::{Failure, Property},
    Budget, Scope,
    books::Books,
    kept::{Kept, Taped},
    tape::{BEGIN, EPOCHS, Keys, NODE, SESSIONS},
};

/// An interface of one process: its node, the index of the process among the node's, and the
/// interface.
pub(super) type End = (u8, u8, InterfaceId);

/// The location of one end of a link's socket pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Socket {
    Underway,
    Held,
    Closed,
}

/// A link's two ends. Removed when both are closed.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Pair {
    pub(super) ends: [End; 2],
    pub(super) sockets: [Socket; 2],
    /// True if any side had a reason to end it.
    pub(super) doomed: bool,
}

/// A frame in flight, and its decoded form.
#[derive(Clone, Debug)]
pub(super) struct Frame<T> {
    pub(super) bytes: Vec<u8>,
    pub(super) says: T,
}

/// An item that a node has not read yet.
#[derive(Clone, Debug, Hash)]
pub(super) enum Down {
    /// A frame, with the descriptor of a link for this interface.
    Frame(Rc<Frame<ToNode>>, Option<(LinkId, InterfaceId)>),
    Eof,
}

#[derive(Clone, Debug, Hash)]
pub(super) struct Connection {
    pub(super) session: NodeId,
    /// The index of the process among the node's processes.
    pub(super) life: u8,
    /// True if the Manager's end is closed.
    pub(super) dead: bool,
    /// True between HELLO of a reconnecting node and its CLAIMED, as far as the Manager has read.
    pub(super) resuming: bool,
    pub(super) up: VecDeque<Rc<Frame<ToManager>>>,
    pub(super) down: VecDeque<Down>,
    /// The ends of links of this session whose farewells are not complete.
    pub(super) books: Books,
}

#[derive(Clone, Debug)]
pub(super) struct Program {
    pub(super) node: Node,
    pub(super) life: u8,
    /// True if this process has connected before.
    pub(super) begun: bool,
    pub(super) connection: Option<Connection>,
    /// Connections that the node has closed and the Manager has not read to their end.
    pub(super) closed: VecDeque<Connection>,
    /// The contract of each interface, and below the contracts that have none yet, as indices into
    /// the scope's list.
    pub(super) interfaces: BTreeMap<InterfaceId, u8>,
    pub(super) undeclared: BTreeSet<u8>,
    /// The interfaces that were declared. A refusal suspends them; that of another one is final.
    pub(super) live: BTreeSet<InterfaceId>,
    /// The contracts that the Manager refused: this process does not declare them again.
    pub(super) refused: BTreeSet<u8>,
    pub(super) links: BTreeSet<(InterfaceId, LinkId)>,
    pub(super) taped: Taped,
}

/// One moment.
#[derive(Clone, Debug)]
pub struct World {
    pub(super) now: Instant,
    /// The number of Managers so far.
    pub(super) epoch: u64,
    pub(super) sessions: u64,
    pub(super) last_link: Option<LinkId>,
    pub(super) manager: Option<Rc<Kept>>,
    pub(super) programs: Vec<Rc<Program>>,
    pub(super) pairs: BTreeMap<LinkId, Pair>,
    /// True if the restriction of the scope is the domain's access policy.
    pub(super) restricted: bool,
    /// True if the present Manager got another access policy while it ran.
    pub(super) reloaded: bool,
    /// Pairs that the present Manager need not link, since one of them ended its link.
    pub(super) broken: BTreeSet<[End; 2]>,
    pub(super) budget: Budget,
    /// The keys of all links so far.
    pub(super) keys: Rc<Keys>,
    /// The failure of the step that led here; the search does not continue from such a moment.
    pub(super) failure: Option<Failure>,
}

impl<T: Hash> Hash for Frame<T> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.says.hash(state);
    }
}

impl Hash for Program {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.node.hash(state);
        (self.life, self.begun).hash(state);
        (&self.connection, &self.closed).hash(state);
        (&self.interfaces, &self.undeclared, &self.links).hash(state);
        (&self.live, &self.refused).hash(state);
    }
}

/// Hashes everything, without renumbering.
impl Hash for World {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.now, self.epoch, self.sessions, self.last_link).hash(state);
        self.manager.as_deref().map(Kept::machine).hash(state);
        (&self.programs, &self.pairs, &self.broken).hash(state);
        (self.restricted, self.reloaded).hash(state);
        self.budget.hash(state);
    }
}

impl Program {
    pub(super) fn new(at: usize, life: u8, scope: &Scope) -> Self {
        let name = String::from_utf8_lossy(NODE).into_owned() + &at.to_string();
        let name = Name::new(&name).expect("a legal name");
        let mut node = Node::new(name);
        if let Some(stated) = scope.room_stated(at) {
            let room = node.handle(BEGIN, Input::MaxLinks(stated));
            room.expect("each node may state its room");
        }
        Self {
            node,
            life,
            begun: false,
            connection: None,
            closed: VecDeque::new(),
            interfaces: BTreeMap::new(),
            undeclared: (0_u8..).take(scope.programs[at].len()).collect(),
            live: BTreeSet::new(),
            refused: BTreeSet::new(),
            links: BTreeSet::new(),
            taped: Taped::default(),
        }
    }
}

impl World {
    /// The first moment of a scope.
    ///
    /// # Errors
    ///
    /// The property that is broken on the way there.
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
            restricted: false,
            reloaded: false,
            broken: BTreeSet::new(),
            budget: scope.budget,
            keys: Rc::default(),
            failure: None,
        };
        world.begin(scope);
        if scope.starts_linked {
            while let Some(&action) = world.progress().first() {
                world = world.step(scope, action)?;
            }
        }
        Ok(world)
    }

    /// The number of the next connection.
    pub(super) const fn next_session(&mut self) -> NodeId {
        self.sessions += 1;
        NodeId(SESSIONS + self.sessions)
    }

    pub(super) const fn epoch_number(&self) -> u64 {
        EPOCHS + self.epoch
    }

    pub(super) fn program(&mut self, at: u8) -> &mut Program {
        let program = Rc::make_mut(&mut self.programs[usize::from(at)]);
        program.taped.forget();
        program
    }

    pub(super) fn fail(&mut self, property: Property, what: impl fmt::Display) {
        let what = what.to_string();
        self.failure.get_or_insert(Failure { property, what });
    }
}

pub(super) fn end_of(ends: &[End; 2], end: End) -> usize {
    usize::from(ends[0] != end)
}
