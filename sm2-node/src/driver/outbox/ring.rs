//! Messages for the ring lane, which are always in a slot with their head at the slot's end.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

use sm2_io::Slot;
use sm2_proto::limits::SLOT_HEAD;
use sm2_proto::link::{Body, OutboundMessage, SlotHead, Status};

use super::{Label, NoForm, NoSlot, Outbox, info};
use crate::driver::message_key::MessageKey;
use crate::pool::Lease;

impl Outbox {
    /// The message for a link that accepts only slots. The message is copied to a slot if no such
    /// link existed when the message was published. Only replies have a status other than ok, and a
    /// reply goes to one link only, so the head in the slot can be rewritten.
    pub(super) fn message_in_slot(
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
        let missing = || io::Error::from(io::ErrorKind::NotFound);
        let message = self.messages.get(key).ok_or_else(missing)?;
        if message.forms.pooled.is_none() {
            self.copy_to_slot(key)?;
        }
        let message = self.messages.get(key).ok_or_else(missing)?;
        let lease = message.forms.pooled.as_ref().ok_or_else(missing)?;
        Ok(OutboundMessage {
            key: key.to_raw(),
            id: message.id,
            time: message.time,
            status,
            len: message.len,
            body: Body::Pooled {
                segment: info(lease),
                slot: lease.slot,
            },
        })
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
            (None, Some(file)) => File::from(file.try_clone()?).read_exact_at(to, 0),
            (None, None) => Err(io::ErrorKind::NotFound.into()),
        }
    }
}

/// Writes the head that receivers of the ring lane read.
//= SM2-RNG-004
pub(super) fn write_head(lease: &mut Lease<Slot>, label: Label, status: Status) {
    let Label { id, time, len } = label;
    let slot = lease.memory.len_bytes();
    if let Some(place) = lease.memory.bytes_mut(slot).last_chunk_mut::<SLOT_HEAD>() {
        *place = SlotHead {
            id,
            time,
            len,
            status,
        }
        .to_bytes();
    }
}
