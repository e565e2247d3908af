//! The rules for a match of two interfaces, and the QoS of their link (SPEC section 4.4).

use crate::{Contract, TypeId};

/// The QoS of a link between two matching interfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkQos {
    /// Whether no message may be displaced.
    pub reliable: bool,
    /// Whether every message is inline or sealed.
    pub sealed: bool,
}

/// The reason why two interfaces do not match: the first that applies, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mismatch {
    /// Their kinds are not counterparts.
    Kind,
    /// Their names differ.
    Name,
    /// Their types differ.
    Type,
    /// The subscriber demands reliability, which the publisher does not offer.
    Reliability,
    /// The subscriber demands a deadline, and the publisher offers none or a longer one.
    Deadline,
    /// The subscriber demands a lease, and the publisher offers none or a longer one.
    Lease,
}

/// Checks whether two interfaces match. Returns the QoS that the two sides alone ask for.
//= SM2-MAT-001, SM2-MAT-003
pub fn match_contracts(one: &Contract, other: &Contract) -> Result<LinkQos, Mismatch> {
    if one.kind().counterpart() != other.kind() {
        return Err(Mismatch::Kind);
    }
    if one.name() != other.name() {
        return Err(Mismatch::Name);
    }
    if let (Some(ours), Some(theirs)) = (one.types(), other.types())
        && ours != theirs
    {
        return Err(Mismatch::Type);
    }
    let reliable = match (one, other) {
        (Contract::Publisher { offer, .. }, Contract::Subscriber { demand, .. })
        | (Contract::Subscriber { demand, .. }, Contract::Publisher { offer, .. }) => {
            if demand.reliable && !offer.reliable {
                return Err(Mismatch::Reliability);
            }
            if !offer.deadline.fulfils(demand.deadline) {
                return Err(Mismatch::Deadline);
            }
            if !offer.lease.fulfils(demand.lease) {
                return Err(Mismatch::Lease);
            }
            demand.reliable
        }
        _ => true,
    };
    Ok(LinkQos {
        reliable,
        sealed: one.sealed() || other.sealed(),
    })
}

/// The types that an interface states: one for a topic, two for a service.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Types<'a> {
    Topic(&'a TypeId),
    Service(&'a TypeId, &'a TypeId),
}

impl Contract {
    /// The types that this interface states; `None` if it takes any.
    pub(crate) const fn types(&self) -> Option<Types<'_>> {
        match self {
            Self::Publisher { data, .. }
            | Self::Subscriber {
                data: Some(data), ..
            } => Some(Types::Topic(data)),
            Self::Server { request, reply, .. }
            | Self::Client {
                types: Some((request, reply)),
                ..
            } => Some(Types::Service(request, reply)),
            Self::Subscriber { data: None, .. } | Self::Client { types: None, .. } => None,
        }
    }
}
