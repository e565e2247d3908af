//! Storing a message in the forms that its links need.

use sm2_io::Preallocated;
use sm2_proto::limits::MESSAGE_MAX;

use super::Handle;
use crate::driver::{DeclaredInterface, Forms, Needs, NoSlot};
use crate::outgoing::Outgoing;
use crate::pool::Lease;
use crate::spare::Fill;
use crate::{EncodeError, StoreError};

impl Handle {
    /// Stores a message in the forms that its links need.
    pub(crate) fn store(&self, message: Outgoing<'_>, needs: Needs) -> Result<Forms, StoreError> {
        self.store_with(message, needs, |_, _| None)
    }

    /// As [`store`](Self::store), with prepared memory for a sealed message, if there is any.
    #[inline]
    pub(crate) fn store_with(
        &self,
        message: Outgoing<'_>,
        needs: Needs,
        spare: impl FnOnce(usize, Fill) -> Option<Preallocated>,
    ) -> Result<Forms, StoreError> {
        let mut forms = Forms::default();
        if needs.nobody() {
            return Ok(forms);
        }
        let len = message.len();
        let short = len <= self.inline_max;
        // First the steps that can fail and need no undoing.
        if needs.sealed && !short {
            check_len(len as u64)?;
            self.check_file(len as u64)?;
            forms.sealed = Some(message.seal(spare)?);
        }
        if needs.slot || (needs.pooled && !short) {
            let mut lease = self.lease(len)?;
            let written = message.write_to(lease.memory.bytes_mut(len));
            forms.pooled = Some(lease);
            if let Err(error) = written {
                return Err(self.not_encoded(forms, error));
            }
        }
        if short && needs.inline() {
            match message.into_bytes() {
                Ok(bytes) => forms.inline = Some(bytes),
                Err(error) => return Err(self.not_encoded(forms, error)),
            }
        }
        Ok(forms)
    }

    /// Frees the memory of a message that was not encoded into it.
    fn not_encoded(&self, forms: Forms, error: EncodeError) -> StoreError {
        self.with_undriven(|interface, context| interface.drop_forms(forms, context));
        StoreError::Encode(error)
    }

    /// Allocates a slot for `len` bytes.
    pub(crate) fn lease(&self, len: usize) -> Result<Lease<sm2_io::Slot>, StoreError> {
        check_len(len as u64)?;
        let now = sm2_io::clock::now();
        let lease = self.with_undriven(|interface, context| {
            interface.prepare_memory(len as u64, context);
            let lease = interface.outbox.lease(len as u64);
            interface.free_idle(now, context);
            lease.map_err(|error| match error {
                NoSlot::Full => full(interface, len as u64),
                NoSlot::Io(error) | NoSlot::Lock(error) => StoreError::Io(error),
            })
        });
        let mut lease = lease?;
        // Without the node's lock, because the first use of a slot takes long.
        lease.memory.warm(len);
        Ok(lease)
    }
}

impl Handle {
    /// Checks whether a file for a sealed message of this length is within the limit.
    pub(crate) fn check_file(&self, len: u64) -> Result<(), StoreError> {
        self.with_undriven(|interface, context| {
            interface.prepare_memory(len, context);
            match interface.outbox.has_room_for_file(len) {
                true => Ok(()),
                false => Err(full(interface, len)),
            }
        })
    }
}

fn full(interface: &DeclaredInterface, len: u64) -> StoreError {
    StoreError::PoolFull {
        len,
        limit_bytes: interface.outbox.pool_limit_bytes(),
    }
}

const fn check_len(len: u64) -> Result<(), StoreError> {
    if len > MESSAGE_MAX {
        return Err(StoreError::TooLong { len });
    }
    Ok(())
}
