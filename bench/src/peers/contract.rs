//! What every peer can do, in the same few words: the loops in [`roles`](crate::roles) are
//! written once, and know nothing else about a peer.

use std::{error::Error, fmt};

use crate::{
    clock::{now_ns, sleep_until},
    job::{Channel, Domain, Read},
};

/// A process' place in a peer's world: a node, a session, a participant.
pub trait Peer: Sized {
    /// Sends.
    type Publisher: Publish;
    /// Receives, and lets a handler see each message.
    type Subscriber<H: Handler>: Subscribe<H>;

    /// Runs the peer's daemon until the director ends; `ready` when others may come. Only
    /// called for peers that have one.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from running.
    fn serve(domain: &Domain, ready: impl FnOnce()) -> Result<(), PeerError> {
        let _ = (domain, ready);
        Err(PeerError::new("run a daemon", "this peer has none"))
    }

    /// Enters. `name` is unique within the domain; `first` is the process that is started first.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from entering.
    fn open(domain: &Domain, name: &str, first: bool) -> Result<Self, PeerError>;

    /// Announces that it sends.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from sending.
    fn publisher(&self, channel: &Channel) -> Result<Self::Publisher, PeerError>;

    /// Announces that it receives.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from receiving.
    fn subscriber<H: Handler>(
        &self,
        channel: &Channel,
        handler: H,
    ) -> Result<Self::Subscriber<H>, PeerError>;

    /// Calls `exchange` of a service of this peer; only called for peers that have services.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from calling.
    fn client(&self, channel: &Channel) -> Result<impl Call, PeerError> {
        let _ = channel;
        Err::<NoServices, _>(PeerError::new("call a service", "this peer has none"))
    }

    /// Answers with as many bytes as were asked with, until the director says stop; `ready` when
    /// clients may come.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from serving.
    fn answer(
        &self,
        channel: &Channel,
        answer: impl FnMut(&[u8], &mut [u8]) + Send + 'static,
        ready: impl FnOnce(),
    ) -> Result<(), PeerError> {
        let _ = (channel, answer, ready);
        Err(PeerError::new("serve", "this peer has no services"))
    }
}

/// The sending end of a channel.
pub trait Publish: Send {
    /// Sends one message of `len` bytes, all of which `write` writes: right into the memory that
    /// is sent from, where the peer lends it.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from sending. That a message is dropped is none, where the peer drops.
    fn publish(&mut self, len: usize, write: impl FnOnce(&mut [u8])) -> Result<(), PeerError>;

    /// Sends `count` messages: one after the other, unless the peer has a better way.
    ///
    /// # Errors
    ///
    /// As [`publish`](Self::publish).
    fn publish_run(
        &mut self,
        count: usize,
        len: usize,
        write: impl FnMut(&mut [u8]),
    ) -> Result<(), PeerError> {
        one_by_one(self, count, len, write)
    }

    /// How many subscribers are there.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from knowing.
    fn matched(&mut self) -> Result<usize, PeerError>;

    /// Waits until `count` are there.
    ///
    /// # Errors
    ///
    /// They do not come; and as [`matched`](Self::matched).
    fn wait_matched(&mut self, count: usize) -> Result<(), PeerError> {
        let until = now_ns() + TIMEOUT_NS;
        while self.matched()? < count {
            if now_ns() > until {
                return Err(PeerError::new("wait for subscribers", "they do not come"));
            }
            sleep_until(now_ns() + 1_000_000);
        }
        Ok(())
    }

    /// Sends what may still be on its way within this process.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from sending.
    fn flush(&mut self) -> Result<(), PeerError> {
        Ok(())
    }
}

/// Sends `count` messages, each by itself.
pub(super) fn one_by_one(
    publisher: &mut (impl Publish + ?Sized),
    count: usize,
    len: usize,
    mut write: impl FnMut(&mut [u8]),
) -> Result<(), PeerError> {
    (0..count).try_for_each(|_| publisher.publish(len, &mut write))
}

/// How long others may take to come, and a reliable message to be taken, in nanoseconds.
pub const TIMEOUT_NS: u64 = 20_000_000_000;

/// The receiving end of a channel.
pub trait Subscribe<H: Handler> {
    /// Lets the handler see what comes, until it says [`Flow::Return`] or this moment of the
    /// monotonic clock. Sleeps or spins meanwhile, as the peer's mode says.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from receiving.
    fn pump(&mut self, until_ns: u64) -> Result<(), PeerError>;

    /// Looks at the handler.
    fn with<R>(&mut self, look: impl FnOnce(&mut H) -> R) -> R;
}

/// What a subscriber does with messages.
pub trait Handler: Send + 'static {
    /// Sees one message where it lies: all of it, or its beginning if that is all it wants and
    /// the rest would cost the peer something.
    fn message(&mut self, message: &[u8]) -> Flow;

    /// How much of a message it reads.
    #[cfg_attr(
        not(feature = "zenoh"),
        expect(dead_code, reason = "only Zenoh has to ask")
    )]
    fn wants(&self) -> Read {
        Read::Full
    }
}

/// What happens after a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// The next one is waited for.
    Continue,
    /// [`Subscribe::pump`] returns.
    Return,
}

/// The calling end of a service.
pub trait Call {
    /// Sends a request that `write` writes, waits for the reply and lets `read` see it.
    ///
    /// # Errors
    ///
    /// Whatever keeps it from calling.
    fn call(
        &mut self,
        len: usize,
        write: impl FnOnce(&mut [u8]),
        read: impl FnOnce(&[u8]),
    ) -> Result<(), PeerError>;
}

/// The client of a peer that has none.
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

/// Why a peer does not do what it was asked for.
#[derive(Debug)]
pub struct PeerError {
    action: &'static str,
    reason: String,
}

impl PeerError {
    /// From the peer's own words.
    pub fn new(action: &'static str, reason: impl Into<String>) -> Self {
        Self {
            action,
            reason: reason.into(),
        }
    }

    /// From the peer's own error, whose causes are told too.
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
