//! One process of a node, with its connection to the Manager.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    hash::{Hash, Hasher},
    rc::Rc,
};

use sm2_proto::{
    InterfaceId, LinkId, Machine, Name, NodeId,
    control::{ToManager, ToNode},
    node::{Input, Node},
};

use super::{
    Scope,
    books::Books,
    kept::Taped,
    tape::{BEGIN, NODE},
};

/// An interface of one process: its node, the index of the process among the node's, and the
/// interface.
pub(super) type End = (u8, u8, InterfaceId);

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
