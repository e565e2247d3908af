//! How a gateway is, as it says itself: the answer of its service `gateway/NAME/status`, in JSON, to an
//! empty request. Other requests are [questions](crate::question).
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
    Config,
    names::status_service,
    shadow::{Because, Change},
    tally::Counts,
};

/// How long one is waited for before the next is looked at.
const STEP: Duration = Duration::from_millis(10);

/// How a gateway is.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Report {
    /// What people call it.
    pub name: String,
    /// Who it is.
    pub id: String,
    /// The peers that there is a connection with.
    pub peers: Vec<PeerReport>,
    /// Those that are trusted, and not connected.
    pub absent: Vec<String>,
    /// What the rules in its shadow would change, if it has such.
    pub shadow: Option<Vec<ShadowReport>>,
}

/// What other rules would change.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct ShadowReport {
    /// What the configuration calls the peer.
    pub peer: String,
    /// `topic` or `service`.
    pub kind: String,
    /// Its name.
    pub name: String,
    /// `be offered`, `no longer be offered`, `come in`, `no longer come in`.
    pub would: String,
    /// `line 12` of the other file, `no rule fits`, `no peer of the file`.
    pub because: String,
}

impl ShadowReport {
    /// `names`: of all peers; `config`: the other file.
    pub(crate) fn new(change: &Change, names: &BTreeMap<GatewayId, Name>, config: &Config) -> Self {
        let (kind, name) = &change.of;
        let peer = names.get(&change.peer);
        let would = match (change.direction, change.would_go) {
            (Direction::Out, true) => "be offered",
            (Direction::Out, false) => "no longer be offered",
            (Direction::In, true) => "come in",
            (Direction::In, false) => "no longer come in",
        };
        let because = match change.because {
            Because::Rule(rule) => match config.rule_lines.get(rule) {
                Some(line) => format!("line {line}"),
                None => format!("rule {rule}"),
            },
            Because::NoRule => "no rule fits".to_owned(),
            Because::NoPeer => "no peer of the file".to_owned(),
        };
        Self {
            peer: peer.map_or_else(|| change.peer.to_string(), Name::to_string),
            kind: word(*kind).to_owned(),
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

/// A peer that there is a connection with.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct PeerReport {
    /// What the configuration calls it.
    pub name: String,
    /// Who it is.
    pub id: String,
    /// Where it is; none, here and below: the connection had no time to say.
    pub address: Option<String>,
    /// The time that it takes there and back, in milliseconds.
    pub rtt_ms: Option<f64>,
    /// What it offers.
    pub offers: Vec<String>,
    /// What it was offered.
    pub offered: Vec<String>,
    /// Messages, requests and replies, since there is this connection.
    pub messages: Counts,
    /// Of these, what is known to be of a topic or a service.
    pub subjects: Vec<SubjectReport>,
    /// How many topics and services the rules deny now: those of the domain that are not offered to
    /// the peer, and those that it offers and that are not taken.
    pub denied: u64,
    /// Which.
    pub denials: Vec<DenialReport>,
}

/// What became of the messages of a topic, or of the requests and replies of a service.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct SubjectReport {
    /// `topic` or `service`.
    pub kind: String,
    /// Its name.
    pub name: String,
    /// In both directions.
    #[serde(flatten)]
    pub counts: Counts,
}

/// What the rules deny.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct DenialReport {
    /// `topic` or `service`.
    pub kind: String,
    /// Its name.
    pub name: String,
    /// `out`: from the domain to the peer; `in`: the other way.
    pub direction: String,
    /// Where the rule stands that says so; none: no rule fits.
    pub line: Option<usize>,
}

/// Why a gateway does not say how it is.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The domain does not let it be asked.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// It does not answer.
    #[error(transparent)]
    Call(#[from] CallError),
    /// It answers with something else.
    #[error("{gateway} answers with what is no report: {source}")]
    NoReport {
        /// Which.
        gateway: Name,
        /// What is wrong with it.
        source: serde_json::Error,
    },
}

/// The status services of a domain's gateways.
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

/// Asks gateways by the names of their services, all at the same time: they have so long to answer.
pub fn ask(
    node: &Node,
    services: BTreeSet<Name>,
    patience: Duration,
) -> Vec<(Name, Result<Report, ReportError>)> {
    call(node, services, &[], patience)
}

/// The same with any question: an empty one is about the report.
pub(crate) fn call<T: DeserializeOwned>(
    node: &Node,
    services: BTreeSet<Name>,
    question: &[u8],
    patience: Duration,
) -> Vec<(Name, Result<T, ReportError>)> {
    let until = Instant::now() + patience;
    let clients = services.into_iter().map(|service| {
        let client = node.client::<[u8], [u8]>(service.as_str());
        (service, client)
    });
    let clients: Vec<(Name, Result<Raw, DeclareError>)> = clients.collect();
    link(&clients, until - patience / 2);
    let calls = clients.into_iter().map(|(service, client)| {
        let left = until.saturating_duration_since(Instant::now());
        let call = client.map_err(ReportError::from).and_then(|client| {
            let call = client.send_timeout(question, left)?;
            // The client stays as long as its call.
            Ok((client, call))
        });
        (service, call)
    });
    // Each call sets out before the first one is waited for.
    let calls: Vec<_> = calls.collect();
    let answers = calls.into_iter().map(|(service, call)| {
        let report = call.and_then(|(_client, call)| {
            let bytes = call.wait()?;
            serde_json::from_slice(&bytes).map_err(|source| ReportError::NoReport {
                gateway: service.clone(),
                source,
            })
        });
        (service, report)
    });
    answers.collect()
}

type Raw = Client<[u8], [u8]>;

/// Waits until each has its server: whether it has one the call says.
fn link(clients: &[(Name, Result<Raw, DeclareError>)], until: Instant) {
    let mut clients: Vec<&Raw> = clients
        .iter()
        .filter_map(|(_, it)| it.as_ref().ok())
        .collect();
    while !clients.is_empty() && Instant::now() < until {
        // One that is stuck does not use up the time of the others.
        clients.retain(|it| it.wait_for_servers_timeout(1, STEP).is_err());
    }
}

/// What a subject is called in reports.
pub(crate) fn label(subject: &Subject) -> String {
    format!("{} {}", word(subject.kind()), subject.name())
}

pub(crate) const fn word(kind: SubjectKind) -> &'static str {
    match kind {
        SubjectKind::Topic => "topic",
        SubjectKind::Service => "service",
    }
}
