//! What a node declares: the interface's kind, name, types and quality of service.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::{Name, limits::QOS_MAX};

/// A message type: its name and the hash of its schema.
//= SM2-NAM-003
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TypeId {
    /// The type's name, without any language's module path.
    pub name: Name,
    /// The hash of its schema.
    pub hash: u64,
}

impl fmt::Display for TypeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (schema {:016x})", self.name, self.hash)
    }
}

/// What a publisher offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Offer {
    /// How many messages a link's sender keeps that the window does not admit yet.
    pub depth: u16,
    /// Whether the publisher can wait for slow subscribers.
    pub reliable: bool,
    /// How many of its last messages it keeps for late joiners.
    pub latched: u16,
    /// Whether it sends every message sealed.
    pub sealed: bool,
}

/// What a subscriber demands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Demand {
    /// How many messages it keeps that the application has not taken.
    pub depth: u16,
    /// Whether nothing may be displaced.
    pub reliable: bool,
    /// How many messages the application may hold at a time, per link.
    pub max_borrowed: u16,
    /// Whether it takes sealed messages only.
    pub sealed: bool,
}

/// What a server or client wants of its links.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ServiceQos {
    /// How many messages it keeps that the application has not taken.
    pub depth: u16,
    /// How many messages the application may hold at a time, per link.
    pub max_borrowed: u16,
    /// Whether it takes sealed messages only.
    pub sealed: bool,
}

/// A declared interface.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Contract {
    /// Sends the messages of a topic.
    Publisher {
        /// The topic.
        topic: Name,
        /// The type of its messages.
        data: TypeId,
        /// What the publisher offers.
        offer: Offer,
    },
    /// Receives the messages of a topic.
    Subscriber {
        /// The topic.
        topic: Name,
        /// The type of its messages; none takes every type.
        data: Option<TypeId>,
        /// What the subscriber demands.
        demand: Demand,
    },
    /// Answers the calls of a service.
    Server {
        /// The service.
        service: Name,
        /// The type of requests.
        request: TypeId,
        /// The type of replies.
        reply: TypeId,
        /// What the server wants of its links.
        qos: ServiceQos,
    },
    /// Calls a service.
    Client {
        /// The service.
        service: Name,
        /// The types of requests and replies; none takes every pair.
        types: Option<(TypeId, TypeId)>,
        /// What the client wants of its links.
        qos: ServiceQos,
    },
}

/// The four kinds of interface. Each has one counterpart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// See [`Contract::Publisher`].
    Publisher,
    /// See [`Contract::Subscriber`].
    Subscriber,
    /// See [`Contract::Server`].
    Server,
    /// See [`Contract::Client`].
    Client,
}

impl Kind {
    /// The kind that this one links with.
    #[must_use]
    pub const fn counterpart(self) -> Self {
        match self {
            Self::Publisher => Self::Subscriber,
            Self::Subscriber => Self::Publisher,
            Self::Server => Self::Client,
            Self::Client => Self::Server,
        }
    }

    /// The word for it.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Publisher => "publisher",
            Self::Subscriber => "subscriber",
            Self::Server => "server",
            Self::Client => "client",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A value of the quality of service is out of its range (SM2-FRM-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {value}: it must be {min} to {QOS_MAX}")]
pub struct QosError {
    /// Which value.
    pub field: &'static str,
    /// What it is.
    pub value: u16,
    /// The least that it may be.
    pub min: u16,
}

impl Contract {
    /// The interface's kind.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Publisher { .. } => Kind::Publisher,
            Self::Subscriber { .. } => Kind::Subscriber,
            Self::Server { .. } => Kind::Server,
            Self::Client { .. } => Kind::Client,
        }
    }

    /// The topic or service.
    #[must_use]
    pub const fn name(&self) -> &Name {
        match self {
            Self::Publisher { topic, .. } | Self::Subscriber { topic, .. } => topic,
            Self::Server { service, .. } | Self::Client { service, .. } => service,
        }
    }

    /// Whether this side wants every message of its links sealed.
    #[must_use]
    pub const fn sealed(&self) -> bool {
        match self {
            Self::Publisher { offer, .. } => offer.sealed,
            Self::Subscriber { demand, .. } => demand.sealed,
            Self::Server { qos, .. } | Self::Client { qos, .. } => qos.sealed,
        }
    }

    /// How many unreleased messages this side accepts on each of its links
    /// (its `window`, SM2-OPN-003): zero for a publisher.
    #[must_use]
    pub const fn window(&self) -> u32 {
        match self {
            Self::Publisher { .. } => 0,
            Self::Subscriber { demand, .. } => demand.depth as u32 + demand.max_borrowed as u32,
            Self::Server { qos, .. } | Self::Client { qos, .. } => {
                qos.depth as u32 + qos.max_borrowed as u32
            }
        }
    }

    /// Checks the ranges of the quality of service.
    //= SM2-FRM-003
    pub fn check_qos(&self) -> Result<(), QosError> {
        let (depth, borrowed, latched) = match self {
            Self::Publisher { offer, .. } => (offer.depth, 1, offer.latched),
            Self::Subscriber { demand, .. } => (demand.depth, demand.max_borrowed, 0),
            Self::Server { qos, .. } | Self::Client { qos, .. } => (qos.depth, qos.max_borrowed, 0),
        };
        in_range("depth", depth, 1)?;
        in_range("max_borrowed", borrowed, 1)?;
        in_range("latched", latched, 0)
    }
}

fn in_range(field: &'static str, value: u16, min: u16) -> Result<(), QosError> {
    if (min..=QOS_MAX).contains(&value) {
        return Ok(());
    }
    Err(QosError { field, value, min })
}
