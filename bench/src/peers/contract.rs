//! The traits that every peer implements. The loops in [`roles`](crate::roles) use nothing else
//! of a peer.

use std::{error::Error, fmt};

use crate::{
    clock::{now_ns, sleep_until},
    job::{Channel, Domain, Read, Recording},
};

/// The connection of a process to a peer's network: a node, a session, a participant.
pub trait Peer: Sized {
    /// The sending end of a channel.
    type Publisher: Publish;
    /// The receiving end of a channel, which passes each message to a handler.
    type Subscriber<H: Handler>: Subscribe<H>;

    /// Runs the peer's daemon until the director ends. Calls `ready` when nodes can connect. Only
    /// called for peers that have a daemon.
    ///
    /// # Errors
    ///
    /// The daemon cannot run.
    fn serve(domain: &Domain, ready: impl FnOnce()) -> Result<(), PeerError> {
        let _ = (domain, ready);
        Err(PeerError::new("run a daemon", "this peer has none"))
    }

    /// Connects. `name` is unique within the domain; `first` is true for the process that is
    /// started first.
    ///
    /// # Errors
    ///
    /// The process cannot connect.
    fn open(domain: &Domain, name: &str, first: bool) -> Result<Self, PeerError>;

    /// Declares a publisher.
    ///
    /// # Errors
    ///
    /// The publisher cannot be declared.
    fn publisher(&self, channel: &Channel) -> Result<Self::Publisher, PeerError>;

    /// Declares a subscriber.
    ///
    /// # Errors
    ///
    /// The subscriber cannot be declared.
    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Self::Subscriber<H>, PeerError>;

    /// Declares a client of a service. Only called for peers that have services.
    ///
    /// # Errors
    ///
    /// The client cannot be declared, or no server comes.
    fn client(&self, channel: &Channel) -> Result<impl Call, PeerError> {
        let _ = channel;
        Err::<NoServices, _>(PeerError::new("call a service", "this peer has none"))
    }

    /// Serves requests until the director sends `stop`. Replies have the length of their requests.
    /// Calls `ready` when clients can connect.
    ///
    /// # Errors
    ///
    /// The server cannot be declared, or a reply cannot be sent.
    fn answer(
        &self,
        channel: &Channel,
        answer: impl FnMut(&[u8], &mut [u8]) + Send + 'static,
        ready: impl FnOnce(),
    ) -> Result<(), PeerError> {
        let _ = (channel, answer, ready);
        Err(PeerError::new("serve", "this peer has no services"))
    }

    /// Records channels into a file until the director sends `stop`. When this returns, the file is complete and on the
    /// disk. Calls `ready` when publishers can connect. Only called for peers that take part in `record`.
    ///
    /// # Errors
    ///
    /// The file cannot be written, or messages cannot be received.
    fn record(&self, recording: &Recording, ready: impl FnOnce()) -> Result<(), PeerError> {
        let _ = (recording, ready);
        Err(PeerError::new("record", "this peer has no recorder"))
    }
}

/// The sending end of a channel.
pub trait Publish: Send {
    /// Sends one message of `len` bytes; `write` writes all of them. Where the peer lends memory,
    /// `write` writes into it without a copy.
    ///
    /// # Errors
    ///
    /// The message cannot be sent. A message that the peer drops by design is not an error.
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError>;

    /// Sends `count` messages: one by one, unless the peer can send many in one call.
    ///
    /// # Errors
    ///
    /// See [`publish`](Self::publish).
    fn publish_run(
        &mut self,
        count: usize,
        len: usize,
        write: impl FnMut(&mut [u8]),
    ) -> Result<(), PeerError> {
        one_by_one(self, count, len, write)
    }

    /// The number of connected subscribers.
    ///
    /// # Errors
    ///
    /// The peer cannot count them.
    fn matched(&mut self) -> Result<usize, PeerError>;

    /// Waits until `count` subscribers are connected.
    ///
    /// # Errors
    ///
    /// The subscribers do not connect in time; see also [`matched`](Self::matched).
    fn wait_matched(&mut self, count: usize) -> Result<(), PeerError> {
        let until = now_ns() + TIMEOUT_NS;
        while self.matched()? < count {
            if now_ns() > until {
                return Err(PeerError::new("wait for subscribers", "timed out"));
            }
            sleep_until(now_ns() + 1_000_000);
        }
        Ok(())
    }

    /// Sends all messages that are still queued within this process.
    ///
    /// # Errors
    ///
    /// The messages cannot be sent.
    fn flush(&mut self) -> Result<(), PeerError> {
        Ok(())
    }
}

/// Sends `count` messages, each with a call of its own.
pub(super) fn one_by_one(
    publisher: &mut (impl Publish + ?Sized),
    count: usize,
    len: usize,
    mut write: impl FnMut(&mut [u8]),
) -> Result<(), PeerError> {
    (0..count).try_for_each(|_| publisher.publish(len, &mut write))
}

/// Timeout for connections, calls and reliable messages, in nanoseconds.
pub const TIMEOUT_NS: u64 = 20_000_000_000;

/// The receiving end of a channel.
pub trait Subscribe<H: Handler> {
    /// Passes messages to the handler until it returns [`Flow::Return`], or until this time of the
    /// monotonic clock. Sleeps or spins while it waits, as the mode of the peer requires.
    ///
    /// # Errors
    ///
    /// Messages cannot be received.
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError>;

    /// Calls `look` with the handler.
    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R;
}

/// The callback of a subscriber.
pub trait Handler: Send + 'static {
    /// Handles one message in place. If the handler [wants](Self::wants) only the header, the peer
    /// may pass only the first part of the message.
    fn message(&mut self, message: &[u8]) -> Flow;

    /// The part of a message that the handler reads.
    #[cfg_attr(
        not(feature = "zenoh"),
        expect(dead_code, reason = "only Zenoh has to ask")
    )]
    fn wants(&self) -> Read {
        Read::Full
    }
}

/// The next step of a subscriber after a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// The subscriber waits for the next message.
    Continue,
    /// [`Subscribe::pump`] returns.
    Return,
}

/// The calling end of a service.
pub trait Call {
    /// Sends a request that `write` writes, waits for the reply, and passes it to `read`.
    ///
    /// # Errors
    ///
    /// The request cannot be sent, or no reply arrives.
    fn call(
        &mut self,
        len: usize,
        write: impl FnOnce(&mut [u8]),
        read: impl FnOnce(&[u8]),
    ) -> Result<(), PeerError>;
}

/// The client of a peer without services.
struct NoServices;

impl Call for NoServices {
    fn call(
        &mut self,
        _: usize,
        _: impl FnOnce(&mut [u8]),
        _: impl FnOnce(&[u8]),
    ) -> Result<(), PeerError> {
        Err(PeerError::new("call a service", "this peer has none"))
    }
}

/// An error of a peer.
#[derive(Debug)]
pub struct PeerError {
    action: &'static str,
    reason: String,
}

impl PeerError {
    /// Makes an error of the action that failed and its reason.
    pub fn new(action: &'static str, reason: impl Into<String>) -> Self {
        Self {
            action,
            reason: reason.into(),
        }
    }

    /// Makes an error of the action that failed and the peer's own error.
    pub fn caused<E: fmt::Display>(action: &'static str) -> impl FnOnce(E) -> Self {
        move |error| Self::new(action, error.to_string())
    }
}

impl fmt::Display for PeerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cannot {}: {}", self.action, self.reason)
    }
}

impl Error for PeerError {}
