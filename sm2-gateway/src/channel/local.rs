//! The queues of the task that owns the domain's nodes.

use tokio::sync::mpsc::{self, error::TrySendError};

use crate::hub::LocalCommand;

/// Capacity of the queue of remote messages that wait to be published.
const MESSAGES: usize = 256;

/// The sending half of the local task's queues.
#[derive(Debug)]
pub(crate) struct LocalHandle {
    commands: mpsc::UnboundedSender<LocalCommand>,
    messages: mpsc::Sender<LocalCommand>,
}

/// The receiving half of the local task's queues.
#[derive(Debug)]
pub(crate) struct LocalInbox {
    commands: mpsc::UnboundedReceiver<LocalCommand>,
    messages: mpsc::Receiver<LocalCommand>,
}

/// The local task's queues: commands first, then messages.
pub(crate) fn channel() -> (LocalHandle, LocalInbox) {
    let (commands, commands_out) = mpsc::unbounded_channel();
    let (messages, messages_out) = mpsc::channel(MESSAGES);
    let handle = LocalHandle { commands, messages };
    let inbox = LocalInbox {
        commands: commands_out,
        messages: messages_out,
    };
    (handle, inbox)
}

impl LocalHandle {
    /// Queues a command. Returns a message if its queue is full.
    pub(crate) fn send(&self, command: LocalCommand) -> Option<LocalCommand> {
        match command {
            LocalCommand::Publish { .. } => match self.messages.try_send(command) {
                Err(TrySendError::Full(message)) => Some(message),
                Ok(()) | Err(TrySendError::Closed(_)) => None,
            },
            command => {
                // The local task ends only with the gateway; then the command is of no use.
                let _ = self.commands.send(command);
                None
            }
        }
    }
}

impl LocalInbox {
    /// The next command; `None` once the handle is dropped.
    pub(crate) async fn recv(&mut self) -> Option<LocalCommand> {
        tokio::select! {
            biased;
            command = self.commands.recv() => command,
            Some(message) = self.messages.recv() => Some(message),
        }
    }
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use sm2_proto::{
        Name, TypeId,
        gateway::{GatewayId, Subject},
    };

    use super::*;
    use crate::peer::CallId;

    #[test]
    fn a_message_that_finds_no_room_comes_back() {
        let (handle, inbox) = channel();
        let name = Name::new("scan").unwrap();
        let subject = Subject::Topic {
            name: name.clone(),
            data: TypeId { name, hash: 0 },
            reliable: false,
            latched: 0,
        };
        let origin = GatewayId([1; 32]);
        let publish = || LocalCommand::Publish {
            subject: subject.clone(),
            origin,
            payload: Bytes::new(),
        };
        for _ in 0..MESSAGES {
            assert_eq!(handle.send(publish()), None);
        }
        assert_eq!(handle.send(publish()), Some(publish()));
        assert_eq!(handle.send(LocalCommand::Cancel { call: CallId(1) }), None);
        drop(inbox);
        assert_eq!(handle.send(publish()), None);
    }
}
