//! Status reports: the answer of the service `gateway/NAME/status` to an empty request, in JSON. Other
//! requests are [availability requests](crate::availability).
//!
//! Field names are part of the interface of `sm2 gateway peers --json` and `sm2 snapshot --json`.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    time::{Duration, Instant},
};

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use sm2_node::{CallError, Client, DeclareError, Node};
use sm2_proto::{
    Contract, Name,
    domain::Domain,
    gateway::{Direction, GatewayId, Subject, SubjectKind},
};

use crate::{
    names::status_service,
    peer::Limits,
    shadow::{Because, Change, Effect},
    tally::Counts,
};

/// Wait for one client before the next client is checked.
const LINK_INTERVAL: Duration = Duration::from_millis(10);

/// The status of a gateway.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Report {
    /// The name of the gateway.
    pub name: String,
    /// The id of the gateway.
    pub id: String,
    /// The connected peers.
    pub peers: Vec<PeerReport>,
    /// The trusted peers without a connection.
    pub absent: Vec<String>,
    /// The topics and services of the domain that peers want and that the gateway has no descriptors for.
    #[serde(default)]
    pub waiting: Vec<String>,
    /// The limits in force.
    pub limits: Limits,
    /// The changes that the shadow configuration would make, if there is one.
    pub shadow: Option<Vec<ShadowReport>>,
}

/// A change that another configuration would make.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct ShadowReport {
    /// The name of the peer.
    pub peer: String,
    /// `topic` or `service`.
    pub kind: String,
    /// Its name.
    pub name: String,
    /// `be offered`, `no longer be offered`, `come in`, `no longer come in`.
    pub would: String,
    /// `line 12` of the other file, `no rule matches`, `not a peer of the file`.
    pub because: String,
}

impl ShadowReport {
    /// `names` has the peers of both configurations; `rule_lines` has the line of each rule of the other one.
    #[must_use]
    pub fn new(change: &Change, names: &BTreeMap<GatewayId, Name>, rule_lines: &[usize]) -> Self {
        let (kind, name) = &change.of;
        let peer = names.get(&change.peer);
        let would = match (change.direction, change.effect) {
            (Direction::Out, Effect::Starts) => "be offered",
            (Direction::Out, Effect::Stops) => "no longer be offered",
            (Direction::In, Effect::Starts) => "come in",
            (Direction::In, Effect::Stops) => "no longer come in",
        };
        let because = match change.because {
            Because::Rule(rule) => match rule_lines.get(rule) {
                Some(line) => format!("line {line}"),
                None => format!("rule {rule}"),
            },
            Because::NoRule => "no rule matches".to_owned(),
            Because::NoPeer => "not a peer of the file".to_owned(),
        };
        Self {
            peer: peer.map_or_else(|| change.peer.to_string(), Name::to_string),
            kind: kind_name(*kind).to_owned(),
            name: name.to_string(),
            would: would.to_owned(),
            because,
        }
    }
}

impl fmt::Display for ShadowReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            peer,
            kind,
            name,
            would,
            because,
        } = self;
        write!(f, "{peer}: {kind} {name} would {would} ({because})")
    }
}

/// A connected peer.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct PeerReport {
    /// Its name in the configuration.
    pub name: String,
    /// Its id.
    pub id: String,
    /// Its address; `None`, as below, if the connection did not report in time.
    pub address: Option<String>,
    /// How long the connection has been established, in seconds.
    pub connected_s: Option<f64>,
    /// The round-trip time in milliseconds.
    pub rtt_ms: Option<f64>,
    /// The topics and services that it offers.
    pub offers: Vec<String>,
    /// The topics and services that it is offered.
    pub offered: Vec<String>,
    /// Counts of messages, requests and replies since the start of the connection.
    pub messages: Counts,
    /// The counts of each topic and service.
    pub subjects: Vec<SubjectReport>,
    /// The number of denied topics and services: those of the domain that the rules do not let out to
    /// the peer, and those of the peer that the rules do not let in.
    pub denied: u64,
    /// The denied topics and services.
    pub denials: Vec<DenialReport>,
}

/// The counts of a topic or service.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct SubjectReport {
    /// `topic` or `service`.
    pub kind: String,
    /// Its name.
    pub name: String,
    /// The counts of both directions.
    #[serde(flatten)]
    pub counts: Counts,
}

/// A denied topic or service.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct DenialReport {
    /// `topic` or `service`.
    pub kind: String,
    /// Its name.
    pub name: String,
    /// `out`: from the domain to the peer; `in`: from the peer to the domain.
    pub direction: String,
    /// The line of the rule; `None` if no rule matches.
    pub line: Option<usize>,
}

/// Why a status request failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The Manager refuses the client.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// The gateway does not answer.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The answer cannot be decoded.
    #[error("cannot decode the answer of {gateway}: {source}; it may be of another version")]
    Decode {
        /// The status service.
        gateway: Name,
        /// The error of the decoder.
        r#source: serde_json::Error,
    },
}

/// The status services of the gateways of a domain.
#[must_use]
pub fn gateways(domain: &Domain) -> BTreeSet<Name> {
    let services = domain.interfaces().filter_map(|it| match it.contract {
        Contract::Server { service, .. } if it.refused.is_none() => Some(service),
        _ => None,
    });
    services.filter(|it| is_status(it)).cloned().collect()
}

fn is_status(service: &Name) -> bool {
    let gateway = service.as_str().strip_prefix("gateway/");
    let gateway = gateway.and_then(|it| Name::new(it.strip_suffix("/status")?).ok());
    gateway.is_some_and(|it| status_service(&it).as_ref() == Ok(service))
}

/// Requests reports from the status services of gateways, at the same time.
pub fn ask(
    node: &Node,
    services: BTreeSet<Name>,
    timeout: Duration,
) -> Vec<(Name, Result<Report, ReportError>)> {
    call(node, services, &[], timeout)
}

/// Sends the same request to several status services and collects the answers.
pub(crate) fn call<T: DeserializeOwned>(
    node: &Node,
    services: BTreeSet<Name>,
    request: &[u8],
    timeout: Duration,
) -> Vec<(Name, Result<T, ReportError>)> {
    let deadline = Instant::now() + timeout;
    let clients = services.into_iter().map(|service| {
        let client = node.client::<[u8], [u8]>(service.as_str());
        (service, client)
    });
    let clients: Clients = clients.collect();
    link(&clients, deadline - timeout / 2);
    // Sending waits for a link that is being opened, so a gateway without one must not come before the others.
    let (linked, others) = clients.into_iter().partition(|(_, it)| is_linked(it));
    let mut answers = exchange(linked, request, deadline);
    answers.extend(exchange(others, request, deadline));
    answers.sort_by(|(one, _), (other, _)| one.cmp(other));
    answers
}

/// Sends a request by several clients, and collects the answers in their order.
fn exchange<T: DeserializeOwned>(
    clients: Clients,
    request: &[u8],
    deadline: Instant,
) -> Vec<(Name, Result<T, ReportError>)> {
    let calls = clients.into_iter().map(|(service, client)| {
        let left = deadline.saturating_duration_since(Instant::now());
        let call = client.map_err(ReportError::from).and_then(|client| {
            let call = client.send_timeout(request, left)?;
            // Dropping the client would cancel its call.
            Ok((client, call))
        });
        (service, call)
    });
    // Sends every request before it waits for the first reply.
    let calls: Vec<_> = calls.collect();
    let answers = calls.into_iter().map(|(service, call)| {
        let report = call.and_then(|(_client, call)| {
            let bytes = call.wait()?;
            serde_json::from_slice(&bytes).map_err(|source| ReportError::Decode {
                gateway: service.clone(),
                source,
            })
        });
        (service, report)
    });
    answers.collect()
}

type RawClient = Client<[u8], [u8]>;
type Clients = Vec<(Name, Result<RawClient, DeclareError>)>;

fn is_linked(client: &Result<RawClient, DeclareError>) -> bool {
    let is_linked = |it: &RawClient| it.wait_for_servers_timeout(1, Duration::ZERO).is_ok();
    client.as_ref().is_ok_and(is_linked)
}

/// Waits until each client has a link to its server. Calls without one fail later.
fn link(clients: &Clients, deadline: Instant) {
    let mut clients: Vec<&RawClient> = clients
        .iter()
        .filter_map(|(_, it)| it.as_ref().ok())
        .collect();
    while !clients.is_empty() && Instant::now() < deadline {
        // Short waits in turn, so that one gateway without a link does not delay the others.
        clients.retain(|it| it.wait_for_servers_timeout(1, LINK_INTERVAL).is_err());
    }
}

/// The kind and name of a subject, as reports show them.
pub(crate) fn subject_label(subject: &Subject) -> String {
    format!("{} {}", kind_name(subject.kind()), subject.name())
}

pub(crate) const fn kind_name(kind: SubjectKind) -> &'static str {
    match kind {
        SubjectKind::Topic => "topic",
        SubjectKind::Service => "service",
    }
}
