//! The task of one connection.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use quinn_proto::{Connection, ConnectionEvent, ConnectionHandle, EndpointEvent};
use sm2_io::quic::Socket;
use sm2_proto::{
    Instant, Name,
    gateway::{GatewayId, SubjectKind, Verdict},
};
use tokio::sync::{
    mpsc::{self, error::TrySendError},
    oneshot,
};

use super::{Message, NetworkMessage, sleep_to};
use crate::{
    clock::Clock,
    peer::{Command, Event, Limits, Me, Peer},
    report::ShadowReport,
    tally::{Counts, Key},
};

/// How many datagrams wait for a connection that has a lot to do.
const DATAGRAMS: usize = 2_048;
/// How many messages do.
const MESSAGES: usize = 64;
/// How many questions do: whoever asks more has no answer.
const QUESTIONS: usize = 16;
/// What is done in one turn, so that all that waits gets its own.
const BURST: usize = 64;
/// How long a connection that is over goes on answering.
const DRAIN: Duration = Duration::from_secs(3);

/// What all tasks share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) clock: Clock,
    pub(super) me: Me,
    pub(super) limits: Limits,
    pub(super) socket: Socket,
    pub(super) hub: mpsc::Sender<Message>,
    pub(super) network: mpsc::UnboundedSender<NetworkMessage>,
    /// Of the peers with a connection: an older process is stale.
    pub(super) epochs: Mutex<BTreeMap<GatewayId, u64>>,
    /// What the rules in the shadow would change, if there are such.
    pub(super) shadow: Mutex<Option<Vec<ShadowReport>>>,
}

/// How a connection is.
#[derive(Clone, Debug)]
pub(super) struct ConnectionReport {
    pub(super) counts: Counts,
    pub(super) counts_by_name: Vec<(Key, Counts)>,
    pub(super) rtt: Duration,
    pub(super) address: SocketAddr,
}

/// The ways to a connection.
#[derive(Clone, Debug)]
pub(crate) struct Senders {
    pub(super) commands: mpsc::UnboundedSender<Command>,
    pub(super) messages: mpsc::Sender<Command>,
    pub(super) endpoint: mpsc::UnboundedSender<ConnectionEvent>,
    pub(super) datagrams: mpsc::Sender<ConnectionEvent>,
    questions: mpsc::Sender<Question>,
}

/// What somebody wants to know.
#[derive(Debug)]
enum Question {
    /// How is the connection?
    Report(oneshot::Sender<ConnectionReport>),
    /// Could this gateway have that of the peer?
    Verdict {
        kind: SubjectKind,
        name: Name,
        answer: oneshot::Sender<Verdict>,
    },
}

#[derive(Debug)]
pub(super) struct Inbox {
    commands: mpsc::UnboundedReceiver<Command>,
    messages: mpsc::Receiver<Command>,
    endpoint: mpsc::UnboundedReceiver<ConnectionEvent>,
    datagrams: mpsc::Receiver<ConnectionEvent>,
    questions: mpsc::Receiver<Question>,
}

pub(super) fn channels() -> (Senders, Inbox) {
    let (commands, commands_out) = mpsc::unbounded_channel();
    let (messages, messages_out) = mpsc::channel(MESSAGES);
    let (endpoint, endpoint_out) = mpsc::unbounded_channel();
    let (datagrams, datagrams_out) = mpsc::channel(DATAGRAMS);
    let (questions, questions_out) = mpsc::channel(QUESTIONS);
    let senders = Senders {
        commands,
        messages,
        endpoint,
        datagrams,
        questions,
    };
    let inbox = Inbox {
        commands: commands_out,
        messages: messages_out,
        endpoint: endpoint_out,
        datagrams: datagrams_out,
        questions: questions_out,
    };
    (senders, inbox)
}

impl Senders {
    /// Gives back a message that finds no room: it is lost, as it would be on the way.
    pub(super) fn command(&self, command: Command) -> Option<Command> {
        match command {
            Command::Message { .. } => match self.messages.try_send(command) {
                Err(TrySendError::Full(message)) => Some(message),
                Ok(()) | Err(TrySendError::Closed(_)) => None,
            },
            command => {
                // A connection that has ended needs to be told nothing.
                let _ = self.commands.send(command);
                None
            }
        }
    }

    /// How is the connection? One that has ended, or has too much to do, does not say.
    pub(super) fn ask(&self) -> oneshot::Receiver<ConnectionReport> {
        let (answer, answered) = oneshot::channel();
        // What is not sent is dropped, and that is the answer.
        let _ = self.questions.try_send(Question::Report(answer));
        answered
    }

    /// Could this gateway have that of the peer?
    pub(super) fn ask_peer(&self, kind: SubjectKind, name: Name) -> oneshot::Receiver<Verdict> {
        let (answer, answered) = oneshot::channel();
        let question = Question::Verdict { kind, name, answer };
        // As with the other question.
        let _ = self.questions.try_send(question);
        answered
    }
}

/// One connection, from its first datagram to its last.
pub(super) struct Task {
    shared: Arc<Shared>,
    handle: ConnectionHandle,
    /// The connection's number, which is not used again.
    number: u64,
    dialled: Option<GatewayId>,
    peer: Peer,
    /// Who waits for an answer of the peer, by the number of the question.
    asked: BTreeMap<u64, oneshot::Sender<Verdict>>,
    last_question: u64,
    has_ended: Option<Instant>,
}

impl Task {
    pub(super) fn new(
        shared: Arc<Shared>,
        handle: ConnectionHandle,
        number: u64,
        dialled: Option<GatewayId>,
        connection: Connection,
    ) -> Self {
        let epochs = lock(&shared.epochs).clone();
        let peer = Peer::new(
            connection,
            shared.clock,
            shared.me.clone(),
            epochs,
            shared.limits,
        );
        Self {
            shared,
            handle,
            number,
            dialled,
            peer,
            asked: BTreeMap::new(),
            last_question: 0,
            has_ended: None,
        }
    }

    pub(super) async fn run(mut self, mut inbox: Inbox) {
        let mut buffer = Vec::new();
        loop {
            let has_more = self.settle(&mut buffer).await;
            if self.peer.is_drained() || self.has_drained() {
                break;
            }
            let drained = self.has_ended.map(|it| it.after(DRAIN));
            let at_once = has_more.then(sm2_io::clock::now);
            let deadlines = [self.peer.deadline(), drained, at_once];
            let wait = sleep_to(deadlines.into_iter().flatten().min());
            tokio::select! {
                biased;
                Some(event) = inbox.endpoint.recv() => self.event(event),
                Some(event) = inbox.datagrams.recv() => {
                    self.event(event);
                    for _ in 0..BURST {
                        let Ok(event) = inbox.datagrams.try_recv() else { break };
                        self.event(event);
                    }
                }
                command = inbox.commands.recv() => match command {
                    Some(command) => self.command(command),
                    None => break,
                },
                Some(question) = inbox.questions.recv() => self.question(question),
                Some(message) = inbox.messages.recv() => self.command(message),
                () = wait => self.peer.handle_timeout(self.shared.clock.now()),
            }
        }
        if !self.peer.is_drained() {
            self.tell_endpoint(EndpointEvent::drained());
        }
    }

    fn has_drained(&self) -> bool {
        let ended = self.has_ended;
        ended.is_some_and(|it| sm2_io::clock::now().since(it) >= DRAIN)
    }

    fn event(&mut self, event: ConnectionEvent) {
        self.peer.handle_event(self.shared.clock.now(), event);
    }

    fn command(&mut self, command: Command) {
        self.peer.command(self.shared.clock.now(), command);
    }

    fn question(&mut self, question: Question) {
        match question {
            Question::Report(answer) => {
                // Whoever asked may have gone.
                let _ = answer.send(self.report());
            }
            Question::Verdict { kind, name, answer } => {
                self.last_question += 1;
                let ask = self.last_question;
                self.asked.insert(ask, answer);
                self.command(Command::Ask { ask, kind, name });
            }
        }
    }

    fn answered(&mut self, ask: u64, verdict: Option<Verdict>) {
        if let (Some(answer), Some(verdict)) = (self.asked.remove(&ask), verdict) {
            // Whoever asked may have gone.
            let _ = answer.send(verdict);
        }
    }

    /// Without a network nobody needs to know.
    fn tell_endpoint(&self, event: EndpointEvent) {
        let handle = self.handle;
        let _ = (self.shared.network).send(NetworkMessage::Endpoint { handle, event });
    }

    /// Does what follows from what happened; whether there may be more to be sent.
    async fn settle(&mut self, buffer: &mut Vec<u8>) -> bool {
        while let Some(event) = self.peer.poll() {
            if let Event::Answered { ask, verdict } = event {
                self.answered(ask, verdict);
                continue;
            }
            if let Event::Ended(reason) = &event {
                // Nobody answers them any more.
                self.asked.clear();
                tracing::info!(address = %self.peer.address(), "{reason}");
                self.has_ended = Some(sm2_io::clock::now());
                if let Some(peer) = self.dialled {
                    let _ = self.shared.network.send(NetworkMessage::Failed { peer });
                }
            }
            let message = Message::Peer {
                connection: self.number,
                event,
            };
            let _ = self.shared.hub.send(message).await;
        }
        while let Some(event) = self.peer.poll_endpoint() {
            self.tell_endpoint(event);
        }
        let segments = self.shared.socket.max_segments();
        let mut has_more = true;
        for _ in 0..BURST {
            buffer.clear();
            let now = self.shared.clock.now();
            let next = self.peer.poll_transmit(now, segments, buffer);
            has_more = next.is_some();
            let Some(transmit) = next else { break };
            if self.shared.socket.send(&transmit, buffer).await.is_err() {
                return false;
            }
        }
        has_more
    }

    fn report(&self) -> ConnectionReport {
        let counts = self.peer.counts_by_name();
        let address = self.peer.address();
        ConnectionReport {
            counts: self.peer.counts(),
            counts_by_name: counts.map(|(key, it)| (key.clone(), it)).collect(),
            rtt: self.peer.rtt(),
            address: SocketAddr::new(address.ip().to_canonical(), address.port()),
        }
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;

    use super::*;

    #[test]
    fn a_message_that_finds_no_room_comes_back() {
        let (senders, inbox) = channels();
        let message = |offer| Command::Message {
            offer,
            sequence: 1,
            published: Instant(0),
            payload: Bytes::new(),
        };
        for _ in 0..MESSAGES {
            assert!(senders.command(message(1)).is_none());
        }
        let back = senders.command(message(7));
        assert!(matches!(back, Some(Command::Message { offer: 7, .. })));
        // What has to be done has room, and with the connection all that is for it is gone.
        assert!(senders.command(Command::Unoffer { offer: 1 }).is_none());
        drop(inbox);
        assert!(senders.command(message(1)).is_none());
    }
}
