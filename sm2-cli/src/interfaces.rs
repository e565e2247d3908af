//! Interfaces in the form that several commands print.

use std::fmt;

use serde::Serialize;
use sm2_proto::{Contract, EntityId, Kind, Name, Period, Refusal, TypeId, domain::InterfaceView};

use crate::{columns::Columns, connect::Session, error::CliError, names, view::View};

/// An interface. Field names are part of the command's interface.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Interface {
    pub(crate) node: String,
    pub(crate) node_id: u64,
    /// The node's number of the interface.
    pub(crate) interface: u64,
    /// `publisher`, `subscriber`, `server` or `client`.
    pub(crate) kind: &'static str,
    /// The topic or service.
    pub(crate) name: String,
    #[serde(flatten)]
    pub(crate) types: Types,
    pub(crate) qos: Qos,
    pub(crate) links: usize,
    /// The reason for which the Manager refused the interface. `None` if it is granted.
    pub(crate) refused: Option<String>,
}

/// The message types. `None` for a subscriber or client that accepts any type.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub(crate) enum Types {
    Topic {
        #[serde(rename = "type")]
        data: Option<Type>,
    },
    Service {
        request: Option<Type>,
        reply: Option<Type>,
    },
}

/// A message type. The hash is a text, since not every reader of JSON supports 64-bit numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Type {
    pub(crate) name: String,
    pub(crate) schema: String,
}

/// The quality of service. A setting that the kind of interface lacks is absent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Qos {
    pub(crate) depth: u16,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) reliable: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) latched: Option<u16>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) max_borrowed: Option<u16>,
    pub(crate) sealed: bool,
    /// The longest time between two messages, in nanoseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) deadline_ns: Option<u64>,
    /// The age at which a message is not delivered any more, in nanoseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) lifespan_ns: Option<u64>,
    /// The longest time between two signs of life of a publisher's program, in nanoseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) liveliness_ns: Option<u64>,
}

/// The type that an interface has stated, and its schema.
#[derive(Default, Serialize)]
pub(crate) struct Stated {
    /// `None` if no interface has stated a type.
    #[serde(rename = "type")]
    pub(crate) data: Option<Type>,
    /// The schema text of SPEC, Annex A. `None` if no node has registered it.
    schema: Option<String>,
}

impl Stated {
    /// Asks the Manager for the schema.
    ///
    /// # Errors
    ///
    /// As [`Session::describe`].
    pub(crate) fn of(session: &Session, data: Option<&TypeId>) -> Result<Self, CliError> {
        let Some(data) = data else {
            return Ok(Self::default());
        };
        Ok(Self {
            data: Some(data.into()),
            schema: session.describe(data)?,
        })
    }

    /// The schema text, or the reason why there is none.
    pub(crate) fn schema(&self) -> &str {
        let schema = self.schema.as_deref();
        schema.unwrap_or("no node has registered its schema")
    }
}

/// The interfaces on a topic or service, including refused ones.
///
/// # Errors
///
/// [`CliError::Unknown`] with a similar name, if there are none.
pub(crate) fn on(
    view: &View<'_>,
    kinds: &[Kind],
    what: &'static str,
    name: &Name,
) -> Result<Vec<Interface>, CliError> {
    let all = view.domain.interfaces();
    let there: Vec<_> = all
        .filter(|it| kinds.contains(&it.contract.kind()) && it.contract.name() == name)
        .map(|it| Interface::new(view, it))
        .collect();
    if there.is_empty() {
        return Err(names::unknown(what, name, view.names(kinds)));
    }
    Ok(there)
}

impl Interface {
    pub(crate) fn new(view: &View<'_>, it: InterfaceView<'_>) -> Self {
        Self::of(view, it.entity, it.contract, it.refused)
    }

    pub(crate) fn of(
        view: &View<'_>,
        entity: EntityId,
        contract: &Contract,
        refused: Option<&Refusal>,
    ) -> Self {
        Self {
            node: view.name_of(entity.node).to_owned(),
            node_id: entity.node.0,
            interface: entity.interface.0,
            kind: contract.kind().as_str(),
            name: contract.name().to_string(),
            types: Types::of(contract),
            qos: Qos::of(contract),
            links: view.links_of(entity).len(),
            refused: refused.map(Refusal::to_string),
        }
    }
}

impl Types {
    fn of(contract: &Contract) -> Self {
        match contract {
            Contract::Publisher { data, .. } => Self::Topic {
                data: Some(data.into()),
            },
            Contract::Subscriber { data, .. } => Self::Topic {
                data: data.as_ref().map(Type::from),
            },
            Contract::Server { request, reply, .. } => Self::Service {
                request: Some(request.into()),
                reply: Some(reply.into()),
            },
            Contract::Client { types, .. } => Self::Service {
                request: types.as_ref().map(|(request, _)| request.into()),
                reply: types.as_ref().map(|(_, reply)| reply.into()),
            },
        }
    }
}

impl From<&TypeId> for Type {
    fn from(data: &TypeId) -> Self {
        Self {
            name: data.name.to_string(),
            schema: format!("{:016x}", data.hash),
        }
    }
}

impl fmt::Display for Type {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (schema {})", self.name, self.schema)
    }
}

impl fmt::Display for Types {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |of: &Option<Type>| of.as_ref().map_or("any", |it| &*it.name).to_owned();
        match self {
            Self::Topic { data } => f.write_str(&name(data)),
            Self::Service { request, reply } => write!(f, "{} -> {}", name(request), name(reply)),
        }
    }
}

impl Qos {
    fn of(contract: &Contract) -> Self {
        let set = |Period(ns)| (ns > 0).then_some(ns);
        let blank = Self {
            depth: 0,
            reliable: None,
            latched: None,
            max_borrowed: None,
            sealed: contract.sealed(),
            deadline_ns: set(contract.deadline()),
            lifespan_ns: set(contract.lifespan()),
            liveliness_ns: set(contract.lease()),
        };
        match contract {
            Contract::Publisher { offer, .. } => Self {
                depth: offer.depth,
                reliable: Some(offer.reliable),
                latched: Some(offer.latched),
                ..blank
            },
            Contract::Subscriber { demand, .. } => Self {
                depth: demand.depth,
                reliable: Some(demand.reliable),
                max_borrowed: Some(demand.max_borrowed),
                ..blank
            },
            Contract::Server { qos, .. } | Contract::Client { qos, .. } => Self {
                depth: qos.depth,
                max_borrowed: Some(qos.max_borrowed),
                ..blank
            },
        }
    }
}

/// `depth 8, reliable, latched 1, sealed, deadline 10ms`
impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "depth {}", self.depth)?;
        if self.reliable == Some(true) {
            f.write_str(", reliable")?;
        }
        if let Some(latched) = self.latched.filter(|&latched| latched > 0) {
            write!(f, ", latched {latched}")?;
        }
        if let Some(borrowed) = self.max_borrowed {
            write!(f, ", borrows {borrowed}")?;
        }
        if self.sealed {
            f.write_str(", sealed")?;
        }
        if let Some(deadline) = self.deadline_ns {
            write!(f, ", deadline {}", Period(deadline))?;
        }
        if let Some(lifespan) = self.lifespan_ns {
            write!(f, ", lifespan {}", Period(lifespan))?;
        }
        if let Some(lease) = self.liveliness_ns {
            write!(f, ", liveliness {}", Period(lease))?;
        }
        Ok(())
    }
}

/// A table of interfaces.
pub(crate) fn table(interfaces: &[Interface]) -> Columns<8> {
    let mut table = Columns::new([
        "NODE", "KIND", "NAME", "TYPE", "NUMBER", "LINKS", "QOS", "STATE",
    ]);
    for it in interfaces {
        let state = it.refused.as_deref();
        table.push([
            it.node.clone(),
            it.kind.into(),
            it.name.clone(),
            it.types.to_string(),
            it.interface.to_string(),
            it.links.to_string(),
            it.qos.to_string(),
            state.map_or("granted".into(), |reason| format!("refused: {reason}")),
        ]);
    }
    table
}
