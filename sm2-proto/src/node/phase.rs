//! The phases of the machine, each with the data that exists in it (SPEC sections 4.2 and 11).

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};

use super::{
    End, Misuse,
    interface::{Interface, Link},
    requests::Requests,
};
use crate::{Contract, InterfaceId, LinkId, NodeId, control::ToManager};

/// The interfaces that a node keeps from one session to the next. A node has none until its first
/// WELCOME; until then its HELLO says that it does not resume.
pub(super) type Known = Option<Interfaces>;

/// The state of the machine: the rows of the tables in SPEC sections 4.2 and 11.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Phase {
    /// HELLO is sent and not answered.
    Greeting(Known),
    /// HELLO_REFUSED has come.
    Refused(Known),
    /// WELCOME has come, and the node declares its interfaces again. At least one of them is
    /// not answered yet.
    Resuming(OpenSession),
    /// The Manager knows all interfaces and links that the node brought along.
    Ready(OpenSession),
    /// The session is over, and another one may follow.
    Away(End, Known),
    /// The machine is over.
    Ended(End),
}

/// The data that exists between WELCOME and the end of the session.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct OpenSession {
    /// The number that the Manager gave to this node.
    pub(super) node: NodeId,
    /// The Manager's incarnation.
    pub(super) epoch: u64,
    pub(super) interfaces: Interfaces,
    /// The interfaces whose DECLARE is not answered yet, in the order in which they were sent.
    pub(super) declaring: VecDeque<InterfaceId>,
    pub(super) requests: Requests,
}

/// The interfaces of a node. They outlive sessions.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Interfaces {
    pub(super) by_id: BTreeMap<InterfaceId, Interface>,
    /// The greatest number that was ever allotted.
    pub(super) last: InterfaceId,
}

impl Phase {
    pub(super) const fn session(&self) -> Option<&OpenSession> {
        match self {
            Self::Resuming(session) | Self::Ready(session) => Some(session),
            Self::Greeting(_) | Self::Refused(_) | Self::Away(..) | Self::Ended(_) => None,
        }
    }

    pub(super) const fn session_mut(&mut self) -> Option<&mut OpenSession> {
        match self {
            Self::Resuming(session) | Self::Ready(session) => Some(session),
            Self::Greeting(_) | Self::Refused(_) | Self::Away(..) | Self::Ended(_) => None,
        }
    }

    /// Whether any Manager has ever welcomed the node; false after the end of the machine.
    pub(super) const fn was_welcomed(&self) -> bool {
        match self {
            Self::Resuming(_) | Self::Ready(_) => true,
            Self::Greeting(known) | Self::Refused(known) | Self::Away(_, known) => known.is_some(),
            Self::Ended(_) => false,
        }
    }

    /// The interfaces; `None` before the first WELCOME and after the end of the machine.
    pub(super) const fn interfaces_mut(&mut self) -> Option<&mut Interfaces> {
        match self {
            Self::Resuming(session) | Self::Ready(session) => Some(&mut session.interfaces),
            Self::Greeting(known) | Self::Refused(known) | Self::Away(_, known) => known.as_mut(),
            Self::Ended(_) => None,
        }
    }

    /// Takes the interfaces out. The caller sets the next phase.
    pub(super) fn take_known(&mut self) -> Known {
        match self.take() {
            Self::Resuming(session) | Self::Ready(session) => Some(session.interfaces),
            Self::Greeting(known) | Self::Refused(known) | Self::Away(_, known) => known,
            Self::Ended(_) => None,
        }
    }

    /// Takes the phase out. The caller sets the next one.
    pub(super) const fn take(&mut self) -> Self {
        core::mem::replace(self, Self::Greeting(None))
    }
}

impl OpenSession {
    pub(super) fn new(node: NodeId, epoch: u64, interfaces: Interfaces) -> Self {
        Self {
            node,
            epoch,
            interfaces,
            declaring: VecDeque::new(),
            requests: Requests::default(),
        }
    }

    /// The DECLARE of one interface, if it is due. The Manager has to answer it.
    pub(super) fn declare(&mut self, interface: InterfaceId) -> Option<ToManager> {
        let contract = self.interfaces.by_id.get_mut(&interface)?.declare()?;
        let frame = ToManager::Declare {
            interface,
            contract: contract.clone(),
        };
        self.declaring.push_back(interface);
        Some(frame)
    }

    /// The DECLAREs of all interfaces whose `contract_due` is a contract. The Manager has
    /// to answer them in this order.
    pub(super) fn declare_all(
        &mut self,
        contract_due: fn(&mut Interface) -> Option<&Contract>,
    ) -> Vec<ToManager> {
        let interfaces = self.interfaces.by_id.iter_mut();
        let frames = interfaces.filter_map(|(&interface, ours)| {
            let contract = contract_due(ours)?.clone();
            self.declaring.push_back(interface);
            Some(ToManager::Declare {
                interface,
                contract,
            })
        });
        frames.collect()
    }
}

impl Interfaces {
    pub(super) const fn new() -> Self {
        Self {
            by_id: BTreeMap::new(),
            last: InterfaceId(0),
        }
    }

    /// Allots the next number to an interface that is not declared yet.
    //= SM2-IFC-001
    pub(super) fn allot(&mut self, contract: Contract) -> Result<InterfaceId, Misuse> {
        let number = self.last.0.checked_add(1);
        let interface = InterfaceId(number.ok_or(Misuse::NumbersSpent)?);
        self.last = interface;
        self.by_id.insert(interface, Interface::new(contract));
        Ok(interface)
    }

    /// Forgets the links that the Manager of this epoch made in earlier sessions: it ended them
    /// with the session.
    //= SM2-SES-006
    pub(super) fn forget_links(&mut self, epoch: u64) -> Vec<(InterfaceId, LinkId)> {
        let interfaces = self.by_id.iter_mut();
        let links = interfaces.flat_map(|(&id, ours)| ours.forget(epoch).map(move |it| (id, it)));
        links.collect()
    }

    /// The links that have to be claimed now.
    //= SM2-RES-002
    pub(super) fn claim_links(&mut self) -> Vec<(InterfaceId, LinkId, Link)> {
        let interfaces = self.by_id.iter_mut();
        let claims = interfaces
            .flat_map(|(&interface, ours)| ours.claim().map(move |(id, it)| (interface, id, it)));
        claims.collect()
    }

    /// The session is over. Returns the interfaces that end with it: those that the program has
    /// withdrawn.
    //= SM2-NOD-003
    pub(super) fn end_session(&mut self) -> Vec<InterfaceId> {
        let mut withdrawn = Vec::new();
        self.by_id.retain(|&interface, ours| {
            let stays = ours.away();
            if !stays {
                withdrawn.push(interface);
            }
            stays
        });
        withdrawn
    }
}
