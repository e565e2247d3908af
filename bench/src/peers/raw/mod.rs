//! Mechanisms of the kernel without any middleware: no discovery, no types, no recovery from a
//! crash. They show the least time that each mechanism takes.

use crate::job::{Channel, Domain};
use crate::peers::contract::{Handler, Peer, PeerError, Publish, Subscribe};

mod futex;
mod region;
mod sealed;
mod seqpacket;
mod shared;

use sealed::{SealedReceiver, SealedSender};
use seqpacket::{PacketReceiver, PacketSender};
use shared::{SharedReceiver, SharedSender, Waiting};

/// A process that knows the folder of the domain.
pub struct Raw {
    domain: Domain,
}

impl Raw {
    fn file(&self, channel: &Channel, ending: &str) -> std::path::PathBuf {
        let name = channel.name.replace('/', "-");
        self.domain.dir.join(format!("{name}.{ending}"))
    }

    fn waiting(&self) -> Option<Waiting> {
        match self.domain.peer.as_str() {
            "raw-futex" => Some(Waiting::Futex),
            "raw-spin" => Some(Waiting::Spin),
            _ => None,
        }
    }
}

impl Peer for Raw {
    type Publisher = RawSender;
    type Subscriber<H: Handler> = RawReceiver<H>;

    fn open(domain: &Domain, _: &str, _: bool) -> Result<Self, PeerError> {
        Ok(Self {
            domain: domain.clone(),
        })
    }

    fn publisher(&self, channel: &Channel) -> Result<RawSender, PeerError> {
        let failed = PeerError::caused::<std::io::Error>("make the shared memory");
        let memory = self.file(channel, "memory");
        if self.domain.peer == "raw-sealed" {
            let sender = SealedSender::new(&self.file(channel, "sock"), channel);
            return sender.map(RawSender::Sealed).map_err(failed);
        }
        match self.waiting() {
            Some(waiting) => SharedSender::new(&memory, channel.max_len, waiting)
                .map(RawSender::Shared)
                .map_err(failed),
            None => PacketSender::new(&memory, &self.file(channel, "sock"), channel)
                .map(RawSender::Packet)
                .map_err(failed),
        }
    }

    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<RawReceiver<H>, PeerError> {
        let failed = PeerError::caused::<std::io::Error>("join the shared memory");
        let memory = self.file(channel, "memory");
        let end = match self.waiting() {
            None if self.domain.peer == "raw-sealed" => {
                SealedReceiver::new(&self.file(channel, "sock"), channel.max_len).map(End::Sealed)
            }
            Some(waiting) => {
                SharedReceiver::new(&memory, channel.max_len, waiting).map(End::Shared)
            }
            None => PacketReceiver::new(&memory, &self.file(channel, "sock"), channel.max_len)
                .map(End::Packet),
        };
        Ok(RawReceiver {
            end: end.map_err(failed)?,
            handler,
        })
    }
}

/// A publisher.
pub enum RawSender {
    /// Shared memory, with a futex or spinning.
    Shared(SharedSender),
    /// Sockets, with long messages in shared memory.
    Packet(PacketSender),
    /// Sockets that carry one sealed file per message.
    Sealed(SealedSender),
}

impl Publish for RawSender {
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError> {
        match self {
            Self::Shared(sender) => sender.publish(len, write),
            Self::Packet(sender) => sender
                .publish(len, write)
                .map_err(PeerError::caused("send a packet")),
            Self::Sealed(sender) => sender
                .publish(len, write)
                .map_err(PeerError::caused("send a file")),
        }
    }

    fn matched(&mut self) -> Result<usize, PeerError> {
        match self {
            Self::Shared(sender) => Ok(sender.matched()),
            Self::Packet(sender) => sender
                .matched()
                .map_err(PeerError::caused("accept a subscriber")),
            Self::Sealed(sender) => sender
                .matched()
                .map_err(PeerError::caused("accept a subscriber")),
        }
    }
}

/// A subscriber.
pub struct RawReceiver<H> {
    end: End,
    handler: H,
}

enum End {
    Shared(SharedReceiver),
    Packet(PacketReceiver),
    Sealed(SealedReceiver),
}

impl<H: Handler> Subscribe<H> for RawReceiver<H> {
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError> {
        match &mut self.end {
            End::Shared(end) => {
                end.pump(&mut self.handler, until_ns);
                Ok(())
            }
            End::Packet(end) => end
                .pump(&mut self.handler, until_ns)
                .map_err(PeerError::caused("receive a packet")),
            End::Sealed(end) => end
                .pump(&mut self.handler, until_ns)
                .map_err(PeerError::caused("receive a file")),
        }
    }

    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R {
        look(&mut self.handler)
    }
}
