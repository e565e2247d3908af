//! The task of the domain's side.

use tokio::{
    sync::mpsc::{self, error::TrySendError},
    task::block_in_place,
};

use crate::{hub::LocalCommand, local::Local};

/// How many remote messages wait to be published.
const MESSAGES: usize = 256;

/// The ways to the domain's side.
#[derive(Debug)]
pub(super) struct Orders {
    commands: mpsc::UnboundedSender<LocalCommand>,
    messages: mpsc::Sender<LocalCommand>,
}

pub(super) struct Inbox {
    commands: mpsc::UnboundedReceiver<LocalCommand>,
    messages: mpsc::Receiver<LocalCommand>,
}

pub(super) fn channel() -> (Orders, Inbox) {
    let (commands, commands_out) = mpsc::unbounded_channel();
    let (messages, messages_out) = mpsc::channel(MESSAGES);
    let orders = Orders { commands, messages };
    let inbox = Inbox {
        commands: commands_out,
        messages: messages_out,
    };
    (orders, inbox)
}

impl Orders {
    /// Gives back a message that finds no room.
    pub(super) fn send(&self, command: LocalCommand) -> Option<LocalCommand> {
        match command {
            LocalCommand::Publish { .. } => match self.messages.try_send(command) {
                Err(TrySendError::Full(message)) => Some(message),
                Ok(()) | Err(TrySendError::Closed(_)) => None,
            },
            command => {
                // It is only gone together with the gateway.
                let _ = self.commands.send(command);
                None
            }
        }
    }
}

pub(super) async fn run(mut local: Local, mut inbox: Inbox) {
    loop {
        let command = tokio::select! {
            biased;
            command = inbox.commands.recv() => command,
            Some(message) = inbox.messages.recv() => Some(message),
        };
        let Some(command) = command else { return };
        // The Manager answers at once, or is stuck: then the other tasks go on.
        block_in_place(|| local.handle(command));
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

    #[test]
    fn a_message_that_finds_no_room_comes_back() {
        let (orders, inbox) = channel();
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
            assert_eq!(orders.send(publish()), None);
        }
        assert_eq!(orders.send(publish()), Some(publish()));
        assert_eq!(orders.send(LocalCommand::Cancel { call: 1 }), None);
        drop(inbox);
        assert_eq!(orders.send(publish()), None);
    }
}
