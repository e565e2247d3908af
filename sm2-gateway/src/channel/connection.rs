//! The queues of a connection task.

use std::{net::SocketAddr, time::Duration};

use quinn_proto::ConnectionEvent;
use sm2_proto::{
    Name,
    gateway::{SubjectKind, Verdict},
};
use tokio::sync::{
    mpsc::{self, error::TrySendError},
    oneshot,
};

use crate::{
    peer::Command,
    tally::{Counts, Key},
};

/// Capacity of the queue of datagrams from the network.
const DATAGRAMS: usize = 2_048;
/// Capacity of the queue of messages for the peer.
const MESSAGES: usize = 64;
/// Capacity of the queue of queries; a query that finds it full has no answer.
const QUERIES: usize = 16;

/// Counts and path of one connection.
#[derive(Clone, Debug)]
pub(crate) struct ConnectionReport {
    pub(crate) counts: Counts,
    pub(crate) counts_by_name: Vec<(Key, Counts)>,
    pub(crate) rtt: Duration,
    /// How long the connection is established; `None` if it is not.
    pub(crate) age: Option<Duration>,
    pub(crate) address: SocketAddr,
}

/// A query to a connection task.
#[derive(Debug)]
pub(crate) enum PeerQuery {
    /// Requests counts and path.
    Report(oneshot::Sender<ConnectionReport>),
    /// Requests that the peer is asked for a topic or service.
    AskPeer {
        kind: SubjectKind,
        name: Name,
        answer: oneshot::Sender<Verdict>,
    },
}

/// The sending half of a connection task's queues.
#[derive(Clone, Debug)]
pub(crate) struct PeerHandle {
    commands: mpsc::UnboundedSender<Command>,
    messages: mpsc::Sender<Command>,
    endpoint: mpsc::UnboundedSender<ConnectionEvent>,
    datagrams: mpsc::Sender<ConnectionEvent>,
    queries: mpsc::Sender<PeerQuery>,
}

/// The receiving half of a connection task's queues.
#[derive(Debug)]
pub(crate) struct PeerInbox {
    /// Commands of the hub, apart from messages. Closed when the hub has dropped its handle.
    pub(crate) commands: mpsc::UnboundedReceiver<Command>,
    /// Messages of the hub.
    pub(crate) messages: mpsc::Receiver<Command>,
    /// Events of the QUIC endpoint, apart from datagrams.
    pub(crate) endpoint: mpsc::UnboundedReceiver<ConnectionEvent>,
    /// Datagrams of the QUIC endpoint.
    pub(crate) datagrams: mpsc::Receiver<ConnectionEvent>,
    /// Queries of the hub.
    pub(crate) queries: mpsc::Receiver<PeerQuery>,
}

/// The queues of one connection task.
pub(crate) fn channel() -> (PeerHandle, PeerInbox) {
    let (commands, commands_out) = mpsc::unbounded_channel();
    let (messages, messages_out) = mpsc::channel(MESSAGES);
    let (endpoint, endpoint_out) = mpsc::unbounded_channel();
    let (datagrams, datagrams_out) = mpsc::channel(DATAGRAMS);
    let (queries, queries_out) = mpsc::channel(QUERIES);
    let handle = PeerHandle {
        commands,
        messages,
        endpoint,
        datagrams,
        queries,
    };
    let inbox = PeerInbox {
        commands: commands_out,
        messages: messages_out,
        endpoint: endpoint_out,
        datagrams: datagrams_out,
        queries: queries_out,
    };
    (handle, inbox)
}

impl PeerHandle {
    /// Queues a command. Returns a message if its queue is full.
    pub(crate) fn command(&self, command: Command) -> Option<Command> {
        match command {
            Command::Message { .. } => match self.messages.try_send(command) {
                Err(TrySendError::Full(message)) => Some(message),
                Ok(()) | Err(TrySendError::Closed(_)) => None,
            },
            command => {
                // A connection that has ended needs no commands.
                let _ = self.commands.send(command);
                None
            }
        }
    }

    /// Queues a datagram. Drops it if the queue is full, so that a slow connection delays no other.
    pub(crate) fn datagram(&self, datagram: ConnectionEvent) {
        let _ = self.datagrams.try_send(datagram);
    }

    /// Queues an event of the QUIC endpoint. A connection that has ended needs none.
    pub(crate) fn endpoint_event(&self, event: ConnectionEvent) {
        let _ = self.endpoint.send(event);
    }

    /// Requests counts and path. The sender is dropped if the connection has ended or is overloaded.
    pub(crate) fn report(&self) -> oneshot::Receiver<ConnectionReport> {
        self.query(PeerQuery::Report)
    }

    /// Asks the peer for a topic or service. The sender is dropped if there is no answer.
    pub(crate) fn ask_peer(&self, kind: SubjectKind, name: Name) -> oneshot::Receiver<Verdict> {
        self.query(|answer| PeerQuery::AskPeer { kind, name, answer })
    }

    fn query<T>(
        &self,
        query: impl FnOnce(oneshot::Sender<T>) -> PeerQuery,
    ) -> oneshot::Receiver<T> {
        let (answer, answered) = oneshot::channel();
        // A query that does not fit is dropped together with its sender, which the receiver sees.
        let _ = self.queries.try_send(query(answer));
        answered
    }
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use sm2_proto::{
        Instant,
        gateway::{OfferId, session::ControlCommand},
    };

    use super::*;
    use crate::message::Message;

    #[test]
    fn a_message_that_finds_no_room_comes_back() {
        let (handle, inbox) = channel();
        let message = |offer| Command::Message {
            offer: OfferId(offer),
            message: Message {
                sequence: 1,
                published_at: Instant(0),
                payload: Bytes::new(),
            },
        };
        for _ in 0..MESSAGES {
            assert!(handle.command(message(1)).is_none());
        }
        let back = handle.command(message(7));
        assert!(matches!(
            back,
            Some(Command::Message {
                offer: OfferId(7),
                ..
            })
        ));
        // Commands that must not be lost find room. When the connection ends, its commands are dropped.
        assert!(
            handle
                .command(Command::Control(ControlCommand::Unoffer {
                    offer: OfferId(1)
                }))
                .is_none()
        );
        drop(inbox);
        assert!(handle.command(message(1)).is_none());
    }
}
