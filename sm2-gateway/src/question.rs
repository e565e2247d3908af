//! Whether a peer could give something: asked of the gateways of a domain, by the same service as
//! [`report`], and by them of the peer (SPEC section 14.3, ASK).

use std::{collections::BTreeSet, fmt, time::Duration};

use serde::{Deserialize, Serialize};
use sm2_node::Node;
use sm2_proto::{
    Name,
    gateway::{SubjectKind, Verdict},
};

use crate::report::{self, ReportError};

/// Could this gateway have that of a peer? As the service takes it, in JSON.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// The peer, by its name or its id.
    pub peer: String,
    /// A topic or a service.
    #[serde(with = "KindWord")]
    pub kind: SubjectKind,
    /// Its name.
    pub name: Name,
}

/// `topic` or `service`.
#[derive(Deserialize, Serialize)]
#[serde(remote = "SubjectKind", rename_all = "lowercase")]
enum KindWord {
    Topic,
    Service,
}

/// The answer, as the service gives it, in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Availability {
    /// It offers it.
    Offered,
    /// Its rules do not let it come.
    Denied,
    /// It knows of none.
    Absent,
    /// There is no connection with it.
    NotConnected,
    /// It is connected and does not answer.
    NoAnswer,
    /// No peer has this name or id.
    NoSuchPeer,
}

impl From<Verdict> for Availability {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Offered => Self::Offered,
            Verdict::Denied => Self::Denied,
            Verdict::Absent => Self::Absent,
        }
    }
}

impl fmt::Display for Availability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Offered => "offered",
            Self::Denied => "denied by the peer's rules",
            Self::Absent => "absent: the peer's domain has none",
            Self::NotConnected => "not connected",
            Self::NoAnswer => "the peer does not answer",
            Self::NoSuchPeer => "no such peer",
        })
    }
}

/// Asks gateways by the names of their services, all at the same time: they have so long to answer.
pub fn ask(
    node: &Node,
    services: BTreeSet<Name>,
    question: &Question,
    patience: Duration,
) -> Vec<(Name, Result<Availability, ReportError>)> {
    // Names and words are always JSON.
    let request = serde_json::to_vec(question).unwrap_or_default();
    report::call(node, services, &request, patience)
}
