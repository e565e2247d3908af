use serde::Serialize;
use sm2_proto::{
    Code, EntityId, InterfaceId, Kind, LinkId, Name, NodeId, Period, Refusal, TypeId,
    schema::Schema,
};

use super::{NearName, difference};

/// The reason why two interfaces are linked or not.
///
/// [`Display`](std::fmt::Display) writes one line with the finding, and a second line with a
/// remedy if there is one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// The publisher or server, if exactly one of the two is one; otherwise the one with the lower
    /// id.
    pub one: Party,
    /// The other interface.
    pub other: Party,
    /// The finding that decides.
    pub finding: Finding,
}

/// An interface, with the names that the domain has for it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Party {
    /// The id of the interface.
    pub entity: EntityId,
    /// The name of its node; `None` if the domain shows no such node.
    pub node: Option<Name>,
    /// The user of the node's process.
    pub uid: Option<u32>,
    /// The kind; `None` if the domain shows no such interface.
    pub kind: Option<Kind>,
    /// The topic or service.
    pub name: Option<Name>,
}

/// The finding that decides: the first that applies, in this order, but `Linked` before all others.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Finding {
    /// The domain has no such interface.
    Unknown {
        /// The interface.
        entity: EntityId,
    },
    /// They are linked.
    Linked {
        /// The link's number.
        link: LinkId,
        /// The protocol version of the link.
        version: u16,
        /// Whether a message may be displaced, and why.
        reliability: Reliability,
        /// The reasons why every message is sealed or inline; empty if messages need not be.
        sealed: Vec<Seal>,
    },
    /// Their kinds are not counterparts.
    Kinds,
    /// Their names differ.
    Names {
        /// How they look alike, if they do.
        near: Option<NearName>,
    },
    /// One of them was refused.
    Refused {
        /// The refused interface.
        entity: EntityId,
        /// The reason.
        reason: Refusal,
        /// An interface that states the other type, if the type is the reason.
        against: Option<Party>,
    },
    /// Their types differ.
    Types {
        /// The types that differ.
        differ: Vec<TypePair>,
    },
    /// The subscriber demands reliability, which the publisher does not offer.
    Reliability,
    /// The subscriber demands a deadline, and the publisher offers none or a longer one.
    Deadline {
        /// The deadline that the publisher offers.
        offered: Period,
        /// The deadline that the subscriber demands.
        demanded: Period,
    },
    /// The subscriber demands a lease, and the publisher offers none or a longer one.
    Liveliness {
        /// The lease that the publisher offers.
        offered: Period,
        /// The lease that the subscriber demands.
        demanded: Period,
    },
    /// They match; one end has claimed their link, and the other has not yet.
    Claimed {
        /// The link's number.
        link: LinkId,
        /// The end that has claimed the link.
        by: EntityId,
    },
    /// They match; a node is still claiming links of an earlier Manager.
    Resuming {
        /// The nodes that are still claiming.
        nodes: Vec<NodeId>,
    },
    /// They match; one of them ended their link, and the Manager does not link them again.
    Ended {
        /// The code that the link ended with.
        code: Code,
    },
    /// They match; a node has used up its quota of links.
    Quota {
        /// The node.
        node: NodeId,
        /// The quota.
        limit: u32,
    },
    /// They match; a node has no room for more links (SM2-LNK-007).
    NoRoom {
        /// The node.
        node: NodeId,
        /// The number of ends of links that the node has.
        used: u32,
        /// The number of ends of links that the node can have.
        max_links: u32,
    },
    /// They match; their link is made as soon as both nodes have read what was sent to them
    /// (SM2-LNK-006).
    Waiting {
        /// The link's number.
        link: LinkId,
    },
    /// They match; the Manager had no descriptors for a link.
    Descriptors,
    /// They match, and no rule prevents a link.
    Due,
}

/// Whether a message of a link may be displaced, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reliability {
    /// Nothing is displaced: the link belongs to a service.
    Service,
    /// Nothing is displaced: the subscriber demands reliability.
    Demanded,
    /// The oldest message is displaced: the subscriber does not demand reliability, though the
    /// publisher offers it.
    NotDemanded,
    /// The oldest message is displaced: the publisher does not offer reliability.
    NotOffered,
}

/// A reason why every message of a link is inline or sealed (SM2-MAT-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Seal {
    /// One of its ends asks for it.
    Asked {
        /// The end that asks for it.
        by: EntityId,
    },
    /// The domain's policy seals every link.
    Policy,
    /// They belong to different users.
    Users,
    /// An earlier Manager sealed the link.
    Kept,
}

/// Two types that have to be equal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TypePair {
    /// The payload that they describe.
    pub part: Part,
    /// The type that the publisher or server states.
    pub offered: TypeId,
    /// The type that the subscriber or client states.
    pub demanded: TypeId,
    /// The first difference of their schemas, if both are known: see [`Verdict::with_schemas`].
    pub difference: Option<String>,
}

/// The payload that a type describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// A topic's messages.
    Messages,
    /// A service's requests.
    Requests,
    /// A service's replies.
    Replies,
}

impl Verdict {
    /// Whether the contracts of the two match (SM2-MAT-001), so that only other rules can prevent a
    /// link.
    #[must_use]
    pub const fn matches(&self) -> bool {
        match self.finding {
            Finding::Linked { .. }
            | Finding::Claimed { .. }
            | Finding::Resuming { .. }
            | Finding::Ended { .. }
            | Finding::Quota { .. }
            | Finding::NoRoom { .. }
            | Finding::Waiting { .. }
            | Finding::Descriptors
            | Finding::Due => true,
            Finding::Unknown { .. }
            | Finding::Kinds
            | Finding::Names { .. }
            | Finding::Refused { .. }
            | Finding::Types { .. }
            | Finding::Reliability
            | Finding::Deadline { .. }
            | Finding::Liveliness { .. } => false,
        }
    }

    /// Whether they are linked.
    #[must_use]
    pub const fn is_linked(&self) -> bool {
        matches!(self.finding, Finding::Linked { .. })
    }

    /// The types whose schema texts would explain more: for [`Verdict::with_schemas`].
    pub fn types(&self) -> impl Iterator<Item = &TypeId> {
        let differ = match &self.finding {
            Finding::Types { differ } => &differ[..],
            _ => &[],
        };
        differ.iter().flat_map(|it| [&it.offered, &it.demanded])
    }

    /// Adds the first difference of types that differ, if `text` knows their schemas.
    #[must_use]
    pub fn with_schemas(mut self, mut text: impl FnMut(&TypeId) -> Option<String>) -> Self {
        if let Finding::Types { differ } = &mut self.finding {
            for pair in differ {
                let mut schema = |data| text(data).and_then(|it| Schema::parse(&it).ok());
                if let (Some(ours), Some(theirs)) = (schema(&pair.offered), schema(&pair.demanded))
                {
                    let difference = difference(&ours, &theirs);
                    pair.difference = difference.map(|it| it.to_string());
                }
            }
        }
        self
    }
}

impl Party {
    /// Whether the entity is a node itself.
    #[must_use]
    pub fn is_node(&self) -> bool {
        self.entity.interface == InterfaceId(0)
    }
}
