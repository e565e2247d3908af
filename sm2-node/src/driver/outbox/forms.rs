//! The message in the form that a link sends.
//!
//! Messages for the ring lane are always in a slot, with their head at the slot's end.
//!
//! A head is written once for all subscribers. The payload has the same offset on both lanes, so one slot serves both.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use sm2_io::memfd;
use sm2_proto::link::{Body, OutboundMessage, Placement, Status};

use super::Outbox;
use super::message::{Forms, StoredMessage, info, write_head};
use super::message_key::MessageKey;
use super::reservation::NoSlot;

/// The reason why a message cannot be put into the form that a link needs.
#[derive(Debug, thiserror::Error)]
pub(in crate::driver) enum NoForm {
    /// There is no slot for the message at this moment.
    #[error("no slot: {0}")]
    Slot(io::Error),
    /// The bytes of the message cannot be copied, or no file can be created for them.
    #[error(transparent)]
    Memory(#[from] io::Error),
}

impl Outbox {
    /// The message in the form that a link with this placement sends. Creates that form if
    /// no other link needed it before.
    ///
    /// # Errors
    /// [`NoForm`]: the message cannot be put into that form.
    pub(in crate::driver) fn message(
        &mut self,
        key: MessageKey,
        status: Status,
        placement: Placement,
    ) -> Result<OutboundMessage, NoForm> {
        match placement {
            Placement::Slot => self.message_in_slot(key, status),
            Placement::InlineOrSlot => self.message_or_file(key, status, false),
            Placement::InlineOrSealed => self.message_or_file(key, status, true),
        }
    }

    fn message_or_file(
        &mut self,
        key: MessageKey,
        status: Status,
        link_sealed: bool,
    ) -> Result<OutboundMessage, NoForm> {
        let missing = || io::Error::from(io::ErrorKind::NotFound);
        let StoredMessage { forms, label, .. } = self.messages.get(key).ok_or_else(missing)?;
        let needs_file = link_sealed && forms.inline.is_none() && forms.sealed.is_none();
        let len = label.len;
        let has_room = !needs_file || self.has_room_for_file(len);
        let message = self.messages.get_mut(key).ok_or_else(missing)?;
        let Forms {
            inline,
            pooled,
            sealed,
        } = &mut message.forms;
        let body = match (inline, pooled) {
            (Some(bytes), _) => Body::Inline(bytes.clone()),
            (None, Some(lease)) if !link_sealed => Body::Pooled {
                segment: info(lease),
                slot: lease.slot,
            },
            // A sealed message is legal on every link.
            (None, _) if sealed.is_some() => Body::Sealed,
            (None, Some(_)) if !has_room => {
                return Err(NoForm::Slot(io::ErrorKind::OutOfMemory.into()));
            }
            (None, Some(lease)) => {
                let len = usize::try_from(message.label.len)
                    .map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
                *sealed = Some(memfd::sealed_from_bytes(lease.memory.bytes(len))?);
                self.pool.add_outside(message.label.len);
                Body::Sealed
            }
            (None, None) => return Err(missing().into()),
        };
        Ok(message.outbound(key, status, body))
    }

    /// The message for a link that accepts only slots. The message is copied to a slot if no such
    /// link existed when the message was published. Only replies have a status other than ok, and a
    /// reply goes to one link only, so the head in the slot can be rewritten.
    fn message_in_slot(
        &mut self,
        key: MessageKey,
        status: Status,
    ) -> Result<OutboundMessage, NoForm> {
        let message = self.pooled_message(key, status)?;
        if status != Status::Ok
            && let Some(label) = self.label(key)
            && let Some(stored) = self.messages.get_mut(key)
            && let Some(lease) = &mut stored.forms.pooled
        {
            write_head(lease, label, status);
        }
        Ok(message)
    }

    fn pooled_message(
        &mut self,
        key: MessageKey,
        status: Status,
    ) -> Result<OutboundMessage, NoForm> {
        if let Some(message) = self.in_slot(key, status) {
            return Ok(message);
        }
        self.copy_to_slot(key)?;
        let missing = || NoForm::from(io::Error::from(io::ErrorKind::NotFound));
        self.in_slot(key, status).ok_or_else(missing)
    }

    /// The message, if it is in a slot.
    #[inline]
    fn in_slot(&self, key: MessageKey, status: Status) -> Option<OutboundMessage> {
        let message = self.messages.get(key)?;
        let lease = message.forms.pooled.as_ref()?;
        let body = Body::Pooled {
            segment: info(lease),
            slot: lease.slot,
        };
        Some(message.outbound(key, status, body))
    }

    fn copy_to_slot(&mut self, key: MessageKey) -> Result<(), NoForm> {
        let label = (self.label(key)).ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))?;
        let mut lease = self.lease(label.len).map_err(|error| match error {
            NoSlot::Full => NoForm::Slot(io::ErrorKind::OutOfMemory.into()),
            NoSlot::Io(error) | NoSlot::Lock(error) => NoForm::Slot(error),
        })?;
        // The lease is for this length, so the range is inside the slot.
        let copied = self.copy_payload(key, lease.memory.bytes_mut(label.len as usize));
        if let Err(error) = copied {
            self.unlease(lease);
            return Err(error.into());
        }
        write_head(&mut lease, label, Status::Ok);
        if let Some(message) = self.messages.get_mut(key) {
            message.forms.pooled = Some(lease);
        }
        Ok(())
    }

    fn copy_payload(&self, key: MessageKey, to: &mut [u8]) -> io::Result<()> {
        let message = self.messages.get(key).ok_or(io::ErrorKind::NotFound)?;
        match (&message.forms.inline, &message.forms.sealed) {
            (Some(bytes), _) => {
                to.copy_from_slice(bytes);
                Ok(())
            }
            (None, Some(file)) => memfd::read_exact_at(file, to, 0),
            (None, None) => Err(io::ErrorKind::NotFound.into()),
        }
    }

    /// The file of a sealed message.
    pub(in crate::driver) fn sealed_file(&self, key: MessageKey) -> Option<BorrowedFd<'_>> {
        let forms = &self.messages.get(key)?.forms;
        Some(forms.sealed.as_ref()?.as_fd())
    }
}
