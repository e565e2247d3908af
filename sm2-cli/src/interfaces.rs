//! Interfaces in the form that several commands print.

use std::fmt;

use serde::Serialize;
use sm2_proto::{
    Contract, EntityId, InterfaceId, Kind, Name, NodeId, Period, Refusal, TypeId,
    domain::InterfaceView,
};

use crate::{
    columns::{Column, Row, cell},
    connect::CommandNode,
    error::CliError,
    names,
    view::{View, service_types, topic_type},
};

/// An interface. Field names are part of the command's interface.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct InterfaceReport {
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
    /// The reason why the Manager refused the interface. `None` if it is granted.
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
    hash: String,
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
    /// The age that ends the delivery of a message, in nanoseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) lifespan_ns: Option<u64>,
    /// The longest time between two signs of life of a publisher's program, in nanoseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) liveliness_ns: Option<u64>,
}

/// The type of a topic, request or reply with its schema. `None` if no interface has stated one.
#[derive(Serialize)]
#[serde(transparent)]
pub(crate) struct StatedType(Option<Described>);

#[derive(Serialize)]
struct Described {
    #[serde(flatten)]
    data: Type,
    /// The schema text of SPEC, Annex A. `None` if no node has registered it.
    schema: Option<String>,
}

impl StatedType {
    /// Asks the Manager for the schema.
    ///
    /// # Errors
    ///
    /// As [`CommandNode::describe`].
    pub(crate) fn of(command_node: &CommandNode, data: Option<&TypeId>) -> Result<Self, CliError> {
        let describe = |data: &TypeId| {
            let schema = command_node.describe(data)?;
            let data = data.into();
            Ok(Described { data, schema })
        };
        data.map(describe).transpose().map(Self)
    }

    /// The type and its schema text, or the reason why there is none.
    pub(crate) fn texts(&self) -> [String; 2] {
        let data = self.0.as_ref().map(|it| it.data.to_string());
        let schema = self.0.as_ref().and_then(|it| it.schema.as_deref());
        [
            data.unwrap_or_else(|| "no interface has stated a type".into()),
            schema
                .unwrap_or("no node has registered its schema")
                .to_owned(),
        ]
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
) -> Result<Vec<InterfaceReport>, CliError> {
    let all = view.domain.interfaces();
    let there: Vec<_> = all
        .filter(|it| kinds.contains(&it.contract.kind()) && it.contract.name() == name)
        .map(|it| InterfaceReport::new(view, it))
        .collect();
    if there.is_empty() {
        return Err(names::unknown(what, name, view.names(kinds)));
    }
    Ok(there)
}

impl InterfaceReport {
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

    pub(crate) const fn entity(&self) -> EntityId {
        EntityId {
            node: NodeId(self.node_id),
            interface: InterfaceId(self.interface),
        }
    }
}

impl Types {
    fn of(contract: &Contract) -> Self {
        match contract.kind() {
            Kind::Publisher | Kind::Subscriber => Self::Topic {
                data: topic_type(contract).map(Type::from),
            },
            Kind::Server | Kind::Client => {
                let types = service_types(contract).map(|both| both.map(Type::from));
                let [request, reply] = types.map_or([None, None], |both| both.map(Some));
                Self::Service { request, reply }
            }
        }
    }
}

impl From<&TypeId> for Type {
    fn from(data: &TypeId) -> Self {
        Self {
            name: data.name.to_string(),
            hash: format!("{:016x}", data.hash),
        }
    }
}

impl fmt::Display for Type {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (schema {})", self.name, self.hash)
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

impl Row for InterfaceReport {
    const COLUMNS: &'static [Column<Self>] = &[
        ("NODE", |it| it.node.clone()),
        ("KIND", |it| it.kind.into()),
        ("NAME", |it| it.name.clone()),
        ("TYPE", |it| it.types.to_string()),
        ("NUMBER", |it| it.interface.to_string()),
        ("LINKS", |it| it.links.to_string()),
        ("QOS", |it| it.qos.to_string()),
        ("STATE", |it| match &it.refused {
            None => "granted".into(),
            Some(reason) => format!("refused: {reason}"),
        }),
    ];
}

/// The name of a type, or `-` if no interface has stated one.
pub(crate) fn type_cell(data: Option<&Type>) -> String {
    cell(data.map(|data| &data.name))
}
