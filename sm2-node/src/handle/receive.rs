//! Taking messages from an interface, and releasing them.

use std::io;
use std::sync::{Arc, Weak};

use sm2_io::is_shortage;
use sm2_proto::control::LinkPeer;

use super::Handle;
use crate::RecvError;
use crate::driver::LinkToken;
use crate::driver::{Context, Full, Header, Interface, SharedInterface, Taken, Until};
use crate::payload::MessageBytes;

impl Handle {
    /// Waits until `take` has put a message into its second parameter. `None` after the timeout. Without a
    /// Manager or without links, waits until they return.
    #[inline]
    pub(crate) fn receive(
        &self,
        until: Until,
        mut take: impl FnMut(&mut Interface, &mut Option<Taken>, &mut Context<'_>) -> Result<(), Full>,
    ) -> Result<Option<Received>, RecvError> {
        self.check_shutdown(until)?;
        // Not a result of the closures, each of which would copy the message.
        let mut taken = None;
        let found = self.interface.wait_as(self.wait, until, |locked| {
            self.find_or_silence(locked, |locked| {
                match locked.change(|interface, context| take(interface, &mut taken, context)) {
                    Ok(()) => taken.is_some().then_some(Ok(())),
                    Err(full) => Some(Err(full)),
                }
            })
        });
        if let Some(Err(full)) = found? {
            return Err(full.into());
        }
        match taken {
            Some(taken) => self.open_for(taken).map(Some),
            None => Ok(None),
        }
    }

    /// A call that would wait does not look for messages after a shutdown: a program that always finds some would
    /// not end.
    #[inline]
    pub(super) fn check_shutdown(&self, until: Until) -> Result<(), RecvError> {
        match until.waits() && self.interface.is_shut_down() {
            true => Err(RecvError::Shutdown),
            false => Ok(()),
        }
    }

    #[inline]
    pub(super) fn open_for(&self, taken: Taken) -> Result<Received, RecvError> {
        let receipt = self.receipt(&taken);
        self.open_with(taken, receipt).map_err(RecvError::from)
    }

    /// Makes a taken message readable. If that is not possible, closes its link.
    pub(crate) fn open(&self, taken: Taken) -> io::Result<Received> {
        let receipt = self.receipt(&taken);
        self.open_with(taken, receipt).map_err(|it| it.source)
    }

    #[inline]
    pub(super) fn open_with(&self, taken: Taken, receipt: Receipt) -> Result<Received, Unreadable> {
        let Taken {
            token,
            peer,
            header,
            source,
        } = taken;
        // SAFETY: only `receipt`, or the `Lent` of its batch, releases the message. `Received`,
        // `Sample`, `Request` and `Reply` drop the bytes before the receipt, `Lent` is dropped
        // after all of them, and none gives the bytes away.
        #[allow(unsafe_code, reason = "the receipt is here: see the SAFETY text")]
        let opened = unsafe { source.open() };
        match opened {
            Ok(bytes) => Ok(Received {
                peer,
                header,
                bytes,
                receipt,
            }),
            Err(source) => {
                self.with_undriven(|interface, context| {
                    interface.unreadable(token, &peer, is_shortage(&source), context);
                });
                Err(Unreadable { peer, source })
            }
        }
    }

    #[inline]
    fn receipt(&self, taken: &Taken) -> Receipt {
        Receipt {
            interface: Arc::downgrade(&self.interface),
            token: taken.token,
            sequence: taken.header.sequence,
        }
    }
}

/// A message that the program holds.
#[derive(Debug)]
pub(crate) struct Received {
    pub(crate) peer: Arc<LinkPeer>,
    pub(crate) header: Header,
    pub(crate) bytes: MessageBytes,
    /// Last, because it releases the message: all other fields are dropped before.
    pub(crate) receipt: Receipt,
}

/// A message that cannot be mapped, because this machine is out of memory.
pub(super) struct Unreadable {
    peer: Arc<LinkPeer>,
    source: io::Error,
}

/// Releases a message when dropped. Keeps neither the node nor its interface alive.
#[derive(Debug)]
pub(crate) struct Receipt {
    interface: Weak<SharedInterface>,
    token: LinkToken,
    sequence: u64,
}

impl Receipt {
    /// The receipt of a message that another value releases.
    pub(super) const fn none() -> Self {
        Self {
            interface: Weak::new(),
            token: LinkToken::FIRST,
            sequence: 0,
        }
    }

    /// The token of its link.
    pub(crate) const fn token(&self) -> LinkToken {
        self.token
    }
}

impl Drop for Receipt {
    //= SM2-MSG-005
    fn drop(&mut self) {
        if let Some(interface) = self.interface.upgrade() {
            interface.lock().change(|interface, context| {
                interface.give_back(self.token, self.sequence, context);
            });
        }
    }
}

impl From<Unreadable> for RecvError {
    fn from(Unreadable { peer, source }: Unreadable) -> Self {
        Self::Map {
            publisher: peer.name.clone(),
            source,
        }
    }
}

impl From<Full> for RecvError {
    fn from(Full { error, peer }: Full) -> Self {
        Self::TooManyBorrowed {
            held: error.max_borrowed,
            publisher: peer.name.clone(),
        }
    }
}
