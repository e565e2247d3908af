//! The queue of the hub task.

use std::collections::BTreeMap;

use sm2_proto::{
    Name,
    gateway::{GatewayId, Verdict, session::Initiator},
};
use tokio::sync::{mpsc, oneshot};

use super::connection::PeerHandle;
use crate::{
    availability::AvailabilityRequest,
    hub::{LocalEvent, Policy},
    peer::{ConnectionId, Event},
    report::Report,
    shadow::{RuleSet, Seen},
};

/// Capacity of the hub's queue.
const CAPACITY: usize = 1_024;

/// An input of the hub task.
#[derive(Debug)]
pub(crate) enum HubEvent {
    /// The network task opened a connection.
    Opened {
        connection: ConnectionId,
        initiator: Initiator,
        handle: PeerHandle,
    },
    /// A connection task reports an event.
    Peer {
        connection: ConnectionId,
        event: Event,
    },
    /// The domain's side reports an event.
    Local(LocalEvent),
    /// Replaces rules and peers.
    Reload {
        policy: Policy,
        labels: ConfigLabels,
    },
    /// Requests a status report.
    Report(oneshot::Sender<Report>),
    /// Requests that a peer is asked for a topic or service.
    AskPeer {
        request: AvailabilityRequest,
        answer: oneshot::Sender<PeerLookup>,
    },
    /// Requests a snapshot of rules and subjects, unless revision `known` is still current.
    Snapshot {
        known: u64,
        answer: oneshot::Sender<Option<PolicySnapshot>>,
    },
    /// Closes all connections.
    Stop,
}

/// The part of a configuration that gives peers and rules their names in the logs and reports of the hub task.
#[derive(Debug)]
pub(crate) struct ConfigLabels {
    /// The name of each trusted peer.
    pub(crate) peers: BTreeMap<GatewayId, Name>,
    /// The line of each rule.
    pub(crate) rule_lines: Vec<usize>,
}

/// The result of the lookup of a peer to ask.
#[derive(Debug)]
pub(crate) enum PeerLookup {
    /// No trusted peer has this name or id.
    Unknown,
    /// The peer has no connection.
    NotConnected,
    /// The peer was asked. The sender is dropped if the peer does not answer.
    Asked(oneshot::Receiver<Verdict>),
}

/// The rules in force, and the subjects that they decide about.
#[derive(Debug)]
pub(crate) struct PolicySnapshot {
    /// Grows with each change of rules or subjects.
    pub(crate) revision: u64,
    pub(crate) rules: RuleSet,
    pub(crate) names: BTreeMap<GatewayId, Name>,
    pub(crate) seen: Seen,
}

/// The hub task has ended.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the gateway is stopping")]
pub(crate) struct HubStopped;

/// The sending half of the hub's queue.
#[derive(Clone, Debug)]
pub(crate) struct HubHandle(mpsc::Sender<HubEvent>);

/// The hub's queue.
pub(crate) fn channel() -> (HubHandle, mpsc::Receiver<HubEvent>) {
    let (sender, receiver) = mpsc::channel(CAPACITY);
    (HubHandle(sender), receiver)
}

impl HubHandle {
    /// Queues an event; waits while the queue is full.
    pub(crate) async fn send(&self, event: HubEvent) -> Result<(), HubStopped> {
        self.0.send(event).await.map_err(|_| HubStopped)
    }

    /// [`send`](Self::send) for a thread outside the runtime.
    pub(crate) fn blocking_send(&self, event: HubEvent) -> Result<(), HubStopped> {
        self.0.blocking_send(event).map_err(|_| HubStopped)
    }

    /// True if the hub task has ended.
    pub(crate) fn is_closed(&self) -> bool {
        self.0.is_closed()
    }

    /// Completes when the hub task has ended.
    #[cfg(feature = "metrics")]
    pub(crate) async fn closed(&self) {
        self.0.closed().await;
    }

    /// The current status of the gateway.
    pub(crate) async fn report(&self) -> Result<Report, HubStopped> {
        self.request(HubEvent::Report).await
    }

    /// Asks a peer for a topic or service.
    pub(crate) async fn ask_peer(
        &self,
        request: AvailabilityRequest,
    ) -> Result<PeerLookup, HubStopped> {
        self.request(|answer| HubEvent::AskPeer { request, answer })
            .await
    }

    /// The rules and subjects, or `None` if `known` is still the current revision.
    pub(crate) async fn snapshot(&self, known: u64) -> Result<Option<PolicySnapshot>, HubStopped> {
        self.request(|answer| HubEvent::Snapshot { known, answer })
            .await
    }

    async fn request<T>(
        &self,
        event: impl FnOnce(oneshot::Sender<T>) -> HubEvent,
    ) -> Result<T, HubStopped> {
        let (answer, answered) = oneshot::channel();
        self.send(event(answer)).await?;
        answered.await.map_err(|_| HubStopped)
    }
}
