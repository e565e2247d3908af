//! Storing a message in the forms that its links need.

use std::borrow::Cow;

use bytes::Bytes;
use sm2_io::Preallocated;
use sm2_proto::limits::MESSAGE_MAX;

use super::Handle;
use crate::StoreError;
use crate::driver::{Forms, Interface, Needs, NoSlot};
use crate::pool::Lease;

impl Handle {
    /// Stores a message in the forms that its links need.
    pub(crate) fn store(&self, bytes: Cow<'_, [u8]>, needs: Needs) -> Result<Forms, StoreError> {
        self.store_with(bytes, needs, |_| None)
    }

    /// As [`store`](Self::store), with prepared memory for a sealed message, if there is any.
    #[inline]
    pub(crate) fn store_with(
        &self,
        bytes: Cow<'_, [u8]>,
        needs: Needs,
        spare: impl FnOnce(usize) -> Option<Preallocated>,
    ) -> Result<Forms, StoreError> {
        let mut forms = Forms::default();
        if needs.nobody() {
            return Ok(forms);
        }
        let short = bytes.len() <= self.inline_max;
        // First the steps that can fail and need no undoing.
        if needs.sealed && !short {
            check_len(bytes.len() as u64)?;
            self.check_file(bytes.len() as u64)?;
            forms.sealed = Some(crate::spare::seal(spare(bytes.len()), &bytes)?);
        }
        if needs.slot || (needs.pooled && !short) {
            let mut lease = self.lease(bytes.len())?;
            lease.memory.bytes_mut(bytes.len()).copy_from_slice(&bytes);
            forms.pooled = Some(lease);
        }
        if short && needs.inline() {
            forms.inline = Some(match bytes {
                Cow::Borrowed(bytes) => Bytes::copy_from_slice(bytes),
                Cow::Owned(bytes) => bytes.into(),
            });
        }
        Ok(forms)
    }

    /// Allocates a slot for `len` bytes.
    pub(crate) fn lease(&self, len: usize) -> Result<Lease<sm2_io::Slot>, StoreError> {
        check_len(len as u64)?;
        let now = sm2_io::clock::now();
        let lease = self.with_undriven(|interface, context| {
            interface.prepare_memory(len as u64, context);
            let lease = interface.outbox.lease(len as u64);
            interface.rest(now, context);
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

fn full(interface: &Interface, len: u64) -> StoreError {
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
