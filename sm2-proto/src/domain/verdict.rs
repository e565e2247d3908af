//! Why two interfaces are linked, or are not.

use alloc::{string::String, vec::Vec};

use serde::Serialize;

use super::NearName;
use crate::{
    Code, EntityId, InterfaceId, Kind, LinkId, Name, NodeId, Refusal, TypeId, schema::Schema,
};

/// Why two interfaces are linked, or are not.
///
/// [`Display`](core::fmt::Display) gives one line that says what is, and, where somebody can
/// do something about it, a second one that says what.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// The publisher or server, if there is just one; else the one with the lower id.
    pub one: Party,
    /// The other one.
    pub other: Party,
    /// What it is that decides.
    pub finding: Finding,
}

/// An interface, with the names that the domain has for it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Party {
    /// Where it is.
    pub entity: EntityId,
    /// The name of its node; none if the domain shows no such node.
    pub node: Option<Name>,
    /// Whose process that is.
    pub uid: Option<u32>,
    /// What it is; none if the domain shows no such interface.
    pub kind: Option<Kind>,
    /// Its topic or service.
    pub name: Option<Name>,
}

/// What decides. The first that applies, in this order, but `Linked` before all others.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Finding {
    /// The domain has no such interface.
    Unknown {
        /// Which.
        entity: EntityId,
    },
    /// They are linked.
    Linked {
        /// The link's number.
        link: LinkId,
        /// The version spoken on it.
        version: u16,
        /// Whether anything on it may be displaced, and why.
        reliability: Reliability,
        /// Why every message on it is sealed or inline; empty if they need not be.
        sealed: Vec<Seal>,
    },
    /// Their kinds are not counterparts.
    Kinds,
    /// Their names differ.
    Names {
        /// How they look alike, if they do.
        near: Option<NearName>,
    },
    /// One was not granted.
    Refused {
        /// Which.
        entity: EntityId,
        /// Why not.
        reason: Refusal,
        /// An interface whose type stands against it, if that is why.
        against: Option<Party>,
    },
    /// Their types differ.
    Types {
        /// The types that do.
        differ: Vec<TypePair>,
    },
    /// The subscriber demands what the publisher does not offer.
    Reliability,
    /// They match; one end has claimed their link, and the other has not yet.
    Claimed {
        /// The link's number.
        link: LinkId,
        /// Who has.
        by: EntityId,
    },
    /// They match; a node is still claiming links of an earlier Manager.
    Resuming {
        /// Which.
        nodes: Vec<NodeId>,
    },
    /// They match; one of them ended their link, and the Manager does not link them again.
    Ended {
        /// Why.
        code: Code,
    },
    /// They match; a node may not have more links.
    Quota {
        /// Which.
        node: NodeId,
        /// How many it may have.
        limit: u32,
    },
    /// They match; the Manager had no descriptors for a link.
    Descriptors,
    /// They match and nothing is in the way.
    Due,
}

/// Whether anything on a link may be displaced, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reliability {
    /// Nothing: it is a service's.
    Service,
    /// Nothing: the subscriber demands so.
    Demanded,
    /// The oldest: the subscriber does not demand otherwise, though the publisher offers it.
    NotDemanded,
    /// The oldest: the publisher offers nothing else.
    NotOffered,
}

/// Why every message on a link is inline or sealed (SM2-MAT-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Seal {
    /// One of its ends asks for it.
    Asked {
        /// Which.
        by: EntityId,
    },
    /// The domain's policy seals every link.
    Policy,
    /// They belong to different users.
    Users,
    /// An earlier Manager wanted it so.
    Kept,
}

/// Two types that should be one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TypePair {
    /// Of what.
    pub part: Part,
    /// What the publisher or server states.
    pub offered: TypeId,
    /// What the subscriber or client states.
    pub demanded: TypeId,
    /// Where their schemas differ first, if those are known: [`Verdict::with_schemas`].
    pub difference: Option<String>,
}

/// What a type is of.
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
    /// Whether the contracts of the two match (SM2-MAT-001), so that they are linked or
    /// would be, were nothing else in the way.
    #[must_use]
    pub const fn matches(&self) -> bool {
        match self.finding {
            Finding::Linked { .. }
            | Finding::Claimed { .. }
            | Finding::Resuming { .. }
            | Finding::Ended { .. }
            | Finding::Quota { .. }
            | Finding::Descriptors
            | Finding::Due => true,
            Finding::Unknown { .. }
            | Finding::Kinds
            | Finding::Names { .. }
            | Finding::Refused { .. }
            | Finding::Types { .. }
            | Finding::Reliability => false,
        }
    }

    /// Whether they are linked.
    #[must_use]
    pub const fn is_linked(&self) -> bool {
        matches!(self.finding, Finding::Linked { .. })
    }

    /// The types whose schema texts would tell more: for [`Verdict::with_schemas`].
    pub fn types(&self) -> impl Iterator<Item = &TypeId> {
        let differ = match &self.finding {
            Finding::Types { differ } => &differ[..],
            _ => &[],
        };
        differ.iter().flat_map(|it| [&it.offered, &it.demanded])
    }

    /// Adds where the types differ, as far as `text` knows their schemas.
    #[must_use]
    pub fn with_schemas(mut self, mut text: impl FnMut(&TypeId) -> Option<String>) -> Self {
        if let Finding::Types { differ } = &mut self.finding {
            for pair in differ {
                let mut schema = |data| text(data).and_then(|it| Schema::parse(&it).ok());
                if let (Some(ours), Some(theirs)) = (schema(&pair.offered), schema(&pair.demanded))
                {
                    let difference = ours.difference(&theirs);
                    pair.difference = difference.map(|it| alloc::format!("{it}"));
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
