//! The contract of an interface: its kind, name, types and quality of service.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::{Name, Period, limits::QOS_MAX};

/// A message type: its name and the hash of its schema.
//= SM2-NAM-003
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TypeId {
    /// The type's name, without any language's module path.
    pub name: Name,
    /// The hash of the type's schema.
    pub hash: u64,
}

impl fmt::Display for TypeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (schema {:016x})", self.name, self.hash)
    }
}

/// The QoS that a publisher offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct OfferedQos {
    /// The number of messages that a link's sender keeps while the window does not admit them.
    pub depth: u16,
    /// Whether the publisher can wait for slow subscribers.
    pub reliable: bool,
    /// The number of last messages that the publisher keeps for late joiners.
    pub latched: u16,
    /// Whether the publisher sends every message sealed.
    pub sealed: bool,
    /// The longest time between two messages.
    pub deadline: Period,
    /// The age that ends the delivery of a message.
    pub lifespan: Period,
    /// The longest time between two signs of life of the publisher's program. None: the publisher is alive as long as
    /// its links are open.
    pub lease: Period,
}

impl OfferedQos {
    /// The QoS of a best-effort publisher of this depth, without any other quality.
    #[must_use]
    pub const fn new(depth: u16) -> Self {
        Self {
            depth,
            reliable: false,
            latched: 0,
            sealed: false,
            deadline: Period::NONE,
            lifespan: Period::NONE,
            lease: Period::NONE,
        }
    }
}

/// The QoS that a subscriber demands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DemandedQos {
    /// The number of messages that are kept for the application.
    pub depth: u16,
    /// Whether no message may be displaced.
    pub reliable: bool,
    /// The number of messages that the application may hold at a time, per link.
    pub max_borrowed: u16,
    /// Whether the subscriber takes sealed messages only.
    pub sealed: bool,
    /// The longest time between two messages of a publisher.
    pub deadline: Period,
    /// The longest time between two signs of life of a publisher's program.
    pub lease: Period,
}

impl DemandedQos {
    /// The QoS of a best-effort subscriber of this depth that holds at most `max_borrowed` messages of a link at a
    /// time, without any other quality.
    #[must_use]
    pub const fn new(depth: u16, max_borrowed: u16) -> Self {
        Self {
            depth,
            reliable: false,
            max_borrowed,
            sealed: false,
            deadline: Period::NONE,
            lease: Period::NONE,
        }
    }
}

/// The QoS that a server or client demands of its links.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ServiceQos {
    /// The number of messages that are kept for the application.
    pub depth: u16,
    /// The number of messages that the application may hold at a time, per link.
    pub max_borrowed: u16,
    /// Whether this side takes sealed messages only.
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
        /// The QoS that the publisher offers.
        offer: OfferedQos,
    },
    /// Receives the messages of a topic.
    Subscriber {
        /// The topic.
        topic: Name,
        /// The type of its messages; `None` takes every type.
        data: Option<TypeId>,
        /// The QoS that the subscriber demands.
        demand: DemandedQos,
    },
    /// Answers the calls of a service.
    Server {
        /// The service.
        service: Name,
        /// The type of requests.
        request: TypeId,
        /// The type of replies.
        reply: TypeId,
        /// The QoS that the server demands.
        qos: ServiceQos,
    },
    /// Calls a service.
    Client {
        /// The service.
        service: Name,
        /// The types of requests and replies; `None` takes every pair.
        types: Option<(TypeId, TypeId)>,
        /// The QoS that the client demands.
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
    /// The kind that links with this one.
    #[must_use]
    pub const fn counterpart(self) -> Self {
        match self {
            Self::Publisher => Self::Subscriber,
            Self::Subscriber => Self::Publisher,
            Self::Server => Self::Client,
            Self::Client => Self::Server,
        }
    }

    /// The name of the kind.
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

/// A QoS value is out of its range (SM2-FRM-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {value}: it must be {min} to {QOS_MAX}")]
pub struct QosError {
    /// The name of the value.
    pub field: &'static str,
    /// The value.
    pub value: u16,
    /// The least legal value.
    pub min: u16,
}

impl Contract {
    /// The kind of the interface.
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

    /// Whether this side demands that every message of its links is sealed.
    #[must_use]
    pub const fn sealed(&self) -> bool {
        match self {
            Self::Publisher { offer, .. } => offer.sealed,
            Self::Subscriber { demand, .. } => demand.sealed,
            Self::Server { qos, .. } | Self::Client { qos, .. } => qos.sealed,
        }
    }

    /// The deadline that a publisher offers or a subscriber demands. Servers and clients have none.
    #[must_use]
    pub const fn deadline(&self) -> Period {
        match self {
            Self::Publisher { offer, .. } => offer.deadline,
            Self::Subscriber { demand, .. } => demand.deadline,
            Self::Server { .. } | Self::Client { .. } => Period::NONE,
        }
    }

    /// The lease that a publisher offers or a subscriber demands. Servers and clients have none.
    #[must_use]
    pub const fn lease(&self) -> Period {
        match self {
            Self::Publisher { offer, .. } => offer.lease,
            Self::Subscriber { demand, .. } => demand.lease,
            Self::Server { .. } | Self::Client { .. } => Period::NONE,
        }
    }

    /// The lifespan of the messages that a publisher sends. All others have none.
    #[must_use]
    pub const fn lifespan(&self) -> Period {
        match self {
            Self::Publisher { offer, .. } => offer.lifespan,
            Self::Subscriber { .. } | Self::Server { .. } | Self::Client { .. } => Period::NONE,
        }
    }

    /// The number of unreleased messages that this side accepts on each of its links (its `window`,
    /// SM2-OPN-003). A publisher accepts none.
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

    /// Checks the ranges of the QoS values.
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
