//! Messages that are written in place, in the memory that their receivers read.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::time::Duration;

use bytes::Bytes;
use sm2_io::{SealedLoan, Slot};

use crate::buffer::AlignedBuffer;
use crate::driver::{Drive, Forms};
use crate::plain::check;
use crate::pool::Lease;
use crate::published::Published;
use crate::publisher::untyped::UntypedPublisher;
use crate::spare::{self, Fill};
use crate::{Plain, PublishError, StoreError};

/// A message that is written in place. Dereferences to the message.
///
/// The initial value is unspecified: zeroes, or the bytes of an earlier message of this publisher.
/// [`publish`](Self::publish) sends the message; dropping the loan releases its memory.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let node = domain.node("camera")?;
/// # let viewer = domain.node("viewer")?.subscriber::<[u8]>("image")?;
/// let images = node.publisher::<[u8]>("image")?;
/// # images.wait_for_subscribers(1)?;
/// let mut image = images.loan_slice(640 * 480)?;  // in shared memory
/// image.fill(0);
/// image[0] = 255;
/// image.publish()?;                               // without a copy
/// # assert_eq!(viewer.recv()?[0], 255);
/// # Ok(())
/// # }
/// ```
pub struct Loan<'p, T: Plain + ?Sized> {
    publisher: &'p UntypedPublisher,
    /// `None` once the loan is published.
    memory: Option<Memory>,
    len: usize,
    holds: PhantomData<T>,
}

enum Memory {
    /// The message is short enough to be sent inside the datagram, or subscribers hold all memory.
    Heap(AlignedBuffer),
    Slot(Lease<Slot>),
    /// A separate file, because all links are sealed.
    Sealed(SealedLoan),
}

impl<'p, T: Plain + ?Sized> Loan<'p, T> {
    pub(crate) fn new(publisher: &'p UntypedPublisher, len: usize) -> Result<Self, StoreError> {
        let (needs, sealed) = publisher.handle.with(Drive::UnlessRings, |interface, _| {
            (interface.needs(len as u64), interface.contract.sealed())
        });
        let all_sealed = needs.sealed || (needs.nobody() && sealed);
        let lease = || match publisher.handle.lease(len) {
            Ok(lease) => Ok(Memory::Slot(lease)),
            Err(error) => without_pool(publisher, error, len),
        };
        let memory =
            if needs.slot || (len > publisher.handle.inline_max && (needs.pooled || !all_sealed)) {
                lease()?
            } else if len <= publisher.handle.inline_max {
                Memory::Heap(AlignedBuffer::zeroed(len))
            } else {
                match publisher.handle.check_file(len as u64) {
                    Ok(()) => {
                        let spare = publisher.take_spare(len, Fill::InPlace);
                        Memory::Sealed(spare::lend(spare, len).map_err(StoreError::Io)?)
                    }
                    Err(error) => without_pool(publisher, error, len)?,
                }
            };
        let loan = Self {
            publisher,
            memory: Some(memory),
            len,
            holds: PhantomData,
        };
        check::<T>(loan.bytes()).map_err(StoreError::Layout)?;
        Ok(loan)
    }

    /// Sends the message. Copies it if a link that opened meanwhile needs another form.
    ///
    /// # Errors
    ///
    /// As [`Publisher::publish`](crate::Publisher::publish).
    pub fn publish(self) -> Result<Published, PublishError> {
        let timeout = self.publisher.publish_timeout;
        self.publish_timeout(timeout)
    }

    /// The same as [`publish`](Self::publish), with a timeout for this message:
    /// see [`Publisher::publish_timeout`](crate::Publisher::publish_timeout).
    ///
    /// # Errors
    ///
    /// As [`Publisher::publish`](crate::Publisher::publish).
    pub fn publish_timeout(mut self, timeout: Duration) -> Result<Published, PublishError> {
        let Some(memory) = self.memory.take() else {
            unreachable!("only publishing and dropping spend a loan");
        };
        let needs = self
            .publisher
            .handle
            .with(Drive::UnlessRings, |interface, _| {
                interface.needs(self.len as u64)
            });
        let mut forms = Forms::default();
        match memory {
            // Subscribers may have released memory since.
            Memory::Heap(buffer) if self.len > self.publisher.handle.inline_max => {
                return (self.publisher).publish(buffer.as_slice().into(), timeout);
            }
            Memory::Heap(buffer) => forms.inline = Some(Bytes::from_owner(buffer)),
            Memory::Slot(lease) => {
                let bytes = lease.memory.bytes(self.len);
                // Sealed here, without the node's lock, because sealing takes long.
                let is_sealed =
                    needs.sealed && self.publisher.handle.check_file(self.len as u64).is_ok();
                let sealed = is_sealed.then(|| self.publisher.seal(bytes)).transpose();
                forms.pooled = Some(lease);
                match sealed {
                    Ok(sealed) => forms.sealed = sealed,
                    Err(error) => {
                        self.memory = forms.pooled.map(Memory::Slot);
                        return Err(StoreError::Io(error).into());
                    }
                }
            }
            Memory::Sealed(loan) => forms.sealed = Some(loan.seal().map_err(StoreError::Io)?),
        }
        (self.publisher).publish_forms(forms, self.len as u64, timeout)
    }

    fn bytes(&self) -> &[u8] {
        match &self.memory {
            Some(Memory::Heap(buffer)) => buffer.as_slice(),
            Some(Memory::Slot(lease)) => lease.memory.bytes(self.len),
            Some(Memory::Sealed(loan)) => loan.as_slice(),
            None => &[],
        }
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        match &mut self.memory {
            Some(Memory::Heap(buffer)) => buffer.as_mut_slice(),
            Some(Memory::Slot(lease)) => lease.memory.bytes_mut(self.len),
            Some(Memory::Sealed(loan)) => loan.as_mut_slice(),
            None => &mut [],
        }
    }
}

/// Memory for a loan outside of the pool, if subscribers hold the pool.
fn without_pool(
    publisher: &UntypedPublisher,
    error: StoreError,
    len: usize,
) -> Result<Memory, StoreError> {
    let is_full = matches!(error, StoreError::PoolFull { .. });
    match is_full
        && publisher
            .handle
            .with_undriven(|interface, _| interface.links.hold_memory())
    {
        true => Ok(Memory::Heap(AlignedBuffer::zeroed(len))),
        false => Err(error),
    }
}

impl<T: Plain + ?Sized> Deref for Loan<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        match T::ref_from_bytes(self.bytes()) {
            Ok(value) => value,
            Err(_) => unreachable!("length and alignment were checked and do not change"),
        }
    }
}

impl<T: Plain + ?Sized> DerefMut for Loan<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        match T::mut_from_bytes(self.bytes_mut()) {
            Ok(value) => value,
            Err(_) => unreachable!("length and alignment were checked and do not change"),
        }
    }
}

impl<T: Plain + ?Sized> Drop for Loan<'_, T> {
    fn drop(&mut self) {
        if let Some(Memory::Slot(lease)) = self.memory.take() {
            let forms = Forms {
                pooled: Some(lease),
                ..Forms::default()
            };
            (self.publisher.handle)
                .with_undriven(|interface, context| interface.drop_forms(forms, context));
        }
    }
}

impl<T: Plain + ?Sized> fmt::Debug for Loan<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let form = match &self.memory {
            Some(Memory::Heap(_)) => "inline",
            Some(Memory::Slot(_)) => "pooled",
            Some(Memory::Sealed(_)) => "sealed",
            None => "spent",
        };
        write!(f, "Loan({form}, {} bytes)", self.len)
    }
}
