//! Availability requests: whether a peer offers a topic or service to a gateway.
//!
//! They go to the same service as [report requests](report). The gateway forwards the request to the
//! peer (SPEC section 14.3, ASK).

use std::{collections::BTreeSet, fmt, time::Duration};

use serde::{Deserialize, Serialize};
use sm2_node::Node;
use sm2_proto::{
    Name,
    gateway::{SubjectKind, Verdict},
};

use crate::report::{self, ReportError};

/// A request for the availability of a topic or service of a peer, as the service takes it in JSON.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct AvailabilityRequest {
    /// The name or id of the peer.
    pub peer: String,
    /// The kind of the name.
    #[serde(with = "KindText")]
    pub kind: SubjectKind,
    /// The name of the topic or service.
    pub name: Name,
}

/// `topic` or `service`.
#[derive(Deserialize, Serialize)]
#[serde(remote = "SubjectKind", rename_all = "lowercase")]
enum KindText {
    Topic,
    Service,
}

/// The answer to an [`AvailabilityRequest`], in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Availability {
    /// The peer offers it to this gateway.
    Offered,
    /// The rules of the peer deny it.
    Denied,
    /// The peer knows no such topic or service.
    Absent,
    /// No connection with the peer.
    NotConnected,
    /// The peer is connected and does not answer.
    NoAnswer,
    /// No trusted peer has this name or id.
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
            Self::Denied => "denied by the rules of the peer",
            Self::Absent => "absent: the peer's domain has none",
            Self::NotConnected => "not connected",
            Self::NoAnswer => "the peer does not answer",
            Self::NoSuchPeer => "no such peer",
        })
    }
}

/// Sends the request to the status services of gateways, at the same time, and collects the answers.
pub fn ask(
    node: &Node,
    services: BTreeSet<Name>,
    request: &AvailabilityRequest,
    timeout: Duration,
) -> Vec<(Name, Result<Availability, ReportError>)> {
    // Strings and names always encode.
    let request = serde_json::to_vec(request).unwrap_or_default();
    report::call(node, services, &request, timeout)
}
