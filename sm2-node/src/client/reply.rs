//! The replies of a service.

use std::fmt;
use std::ops::Deref;

use sm2_proto::Name;
use sm2_proto::link::Status;

use crate::handle::receive::{Receipt, Received};
use crate::{CallError, Message};

/// A reply. Dereferences to the message; dropping it releases the message.
pub struct Reply<R: Message + ?Sized> {
    /// Before the receipt, so that it is dropped first: the view may refer to the slot that the receipt
    /// releases.
    view: R::View,
    receipt: Receipt,
}

impl<R: Message + ?Sized> Reply<R> {
    pub(super) fn new(service: Name, received: Received) -> Result<Self, CallError> {
        let Received {
            receipt,
            header,
            bytes,
        } = received;
        match header.status {
            Status::Ok => match R::view_in_place(bytes) {
                Ok(view) => Ok(Self { view, receipt }),
                Err(reason) => Err(CallError::Payload { service, reason }),
            },
            Status::Failed => {
                let reason = String::from_utf8_lossy(&bytes.into_payload()).into_owned();
                Err(CallError::Failed { service, reason })
            }
            Status::Cancelled => Err(CallError::Cancelled { service }),
            Status::DeadlinePassed => Err(CallError::DeadlineExceeded { service }),
        }
    }

    /// The name of the server's node.
    #[must_use]
    pub fn server(&self) -> &Name {
        &self.receipt.peer().name
    }
}

impl<R: Message + ?Sized> Deref for Reply<R> {
    type Target = R;

    fn deref(&self) -> &R {
        &self.view
    }
}

impl<R: Message + ?Sized + fmt::Debug> fmt::Debug for Reply<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reply")
            .field("server", &self.receipt.peer().name)
            .field("message", &&**self)
            .finish()
    }
}
