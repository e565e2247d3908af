//! Taking messages from an interface, and releasing them.

use std::io;
use std::sync::Arc;

use sm2_io::memfd::{Side, blame};
use sm2_proto::control::LinkPeer;

use super::Handle;
use crate::RecvError;
use crate::driver::{
    Context, DeclaredInterface, Full, Header, Held, LinkToken, Origin, Taken, Until,
};
use crate::payload::MessageBytes;

impl Handle {
    /// Waits until `take` has put a message into its second parameter. `None` after the timeout. Without a
    /// Manager or without links, waits until they return.
    #[inline]
    pub(crate) fn receive(
        &self,
        until: Until,
        mut take: impl FnMut(
            &mut DeclaredInterface,
            &mut Option<Taken>,
            &mut Context<'_>,
        ) -> Result<(), Full>,
    ) -> Result<Option<Received>, RecvError> {
        loop {
            let Some(taken) = self.take(until, &mut take)? else {
                return Ok(None);
            };
            match self.open_for(taken) {
                Ok(received) => return Ok(Some(received)),
                Err(unreadable) => unreadable.check()?,
            }
        }
    }

    #[inline]
    fn take(
        &self,
        until: Until,
        take: &mut impl FnMut(
            &mut DeclaredInterface,
            &mut Option<Taken>,
            &mut Context<'_>,
        ) -> Result<(), Full>,
    ) -> Result<Option<Taken>, RecvError> {
        self.check_shutdown(until)?;
        // Not a result of the closures, since each of them would copy the message.
        let mut taken = None;
        let found = self.interface.wait_for_message(self.wait, until, |locked| {
            self.find_or_clear(locked, |locked| {
                match locked.change(|interface, context| take(interface, &mut taken, context)) {
                    Ok(()) => taken.is_some().then_some(Ok(())),
                    Err(full) => Some(Err(full)),
                }
            })
        });
        if let Some(Err(full)) = found? {
            return Err(full.into());
        }
        Ok(taken)
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

    /// Makes a taken message readable. If that is the sender's fault, closes its link.
    #[inline]
    pub(crate) fn open_for(&self, taken: Taken) -> Result<Received, Unreadable> {
        let sequence = taken.header.sequence;
        self.open_with(taken, sequence)
    }

    /// As [`open_for`](Self::open_for), for a message that another value releases.
    #[inline]
    pub(super) fn open_lent(&self, taken: Taken) -> Result<Received, Unreadable> {
        self.open_with(taken, 0)
    }

    #[inline]
    fn open_with(&self, taken: Taken, sequence: u64) -> Result<Received, Unreadable> {
        let Taken {
            origin,
            header,
            source,
        } = taken;
        let sequence = if origin.is_released() { sequence } else { 0 };
        let receipt = Receipt { origin, sequence };
        // SAFETY: only `receipt`, or the `Lent` of its batch, releases the message, and `receipt` holds its
        // segment. `Received`, `Sample`, `Request` and `Reply` drop the bytes before the receipt, as do the
        // functions that take a `Received` apart: they name the receipt first. `Lent` is dropped after all of
        // them, and none gives the bytes away.
        #[allow(unsafe_code, reason = "the receipt is here: see the SAFETY text")]
        let opened = unsafe { source.open(&receipt.origin) };
        match opened {
            Ok(bytes) => Ok(Received {
                header,
                bytes,
                receipt,
            }),
            Err(source) => {
                let side = blame(&source);
                let Origin { token, peer, .. } = &*receipt.origin;
                self.with_undriven(|interface, context| match side {
                    Side::Receiver => interface.lose(peer, 1),
                    Side::Sender => interface.unreadable(*token, peer, &source, context),
                });
                let peer = Arc::clone(peer);
                Err(Unreadable { peer, source, side })
            }
        }
    }
}

/// A message that the program holds.
#[derive(Debug)]
pub(crate) struct Received {
    pub(crate) header: Header,
    pub(crate) bytes: MessageBytes,
    /// Last, because it releases the message: all other fields are dropped before.
    pub(crate) receipt: Receipt,
}

/// A message that cannot be mapped. It is lost, and counted as that.
pub(crate) struct Unreadable {
    peer: Arc<LinkPeer>,
    pub(crate) source: io::Error,
    /// The side that causes it. If it is the sender, its link is closed.
    pub(crate) side: Side,
}

impl Unreadable {
    /// No sender makes a call of the program fail: the program goes on with the messages of others.
    ///
    /// # Errors
    ///
    /// This process is short of something.
    //= SM2-SEG-001, SM2-TRN-013
    pub(super) fn check(self) -> Result<(), RecvError> {
        match self.side {
            Side::Sender => Ok(()),
            Side::Receiver => Err(RecvError::Map {
                publisher: self.peer.name.clone(),
                source: self.source,
            }),
        }
    }
}

/// Releases a message when dropped. Keeps neither the node nor its interface alive.
#[derive(Debug)]
pub(crate) struct Receipt {
    origin: Held,
    /// The number of the message on its link, from 1; 0 if another value releases the message, or it needs no release.
    sequence: u64,
}

impl Receipt {
    /// The token of its link.
    pub(crate) fn token(&self) -> LinkToken {
        self.origin.token
    }

    /// The process that sent the message.
    #[inline]
    pub(crate) fn peer(&self) -> &Arc<LinkPeer> {
        &self.origin.peer
    }
}

impl Drop for Receipt {
    //= SM2-MSG-005
    #[inline]
    fn drop(&mut self) {
        if self.sequence != 0
            && let Some(interface) = self.origin.interface.upgrade()
        {
            interface.give_back(self.origin.token, self.sequence);
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
