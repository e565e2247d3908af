//! Proofs about files that another process made.
//!
//! A descriptor that came from another process may name anything. Before this process maps it,
//! three questions have to be answered: can the file become shorter under the mapping (reading
//! past its end kills the reader with `SIGBUS`), who can change its bytes, and how long is it.
//! The kernel answers them once and for ever: a seal cannot be removed, and the size of a file
//! with the seals `SHRINK` and `GROW` does not change.
//!
//! [`InspectedFd`] keeps a descriptor together with these answers, and hands them to the protocol,
//! which decides by SM2-SEG-001 whether the file is legal. The next types prove what
//! memory safety needs. Their fields are private and only [`InspectedFd`] makes them, so that no
//! mapping exists without its proof:
//!
//! | proof | seals beside `SEAL`, `SHRINK`, `GROW` | what never changes | mapping |
//! | --- | --- | --- | --- |
//! | [`SealedFile`] | `WRITE` | size and bytes | [`SealedMapping`]: slices |
//! | [`PooledFile`] | `FUTURE_WRITE` | size; the set of writable mappings | [`PooledMapping`]: copies, raw pointers |
//! | [`RingFile`] | none | size | [`Ring`]: atomic words |
//!
//! [`SealedMapping`]: crate::SealedMapping
//! [`PooledMapping`]: crate::PooledMapping
//! [`Ring`]: crate::Ring

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use sm2_proto::{FdFacts, Seals};

use super::blame::{Side, blame};
use super::facts::facts;

/// A descriptor of unknown origin and the kernel's facts about it.
#[derive(Debug)]
pub struct InspectedFd {
    fd: OwnedFd,
    facts: FdFacts,
}

impl InspectedFd {
    /// Asks the kernel about `fd` ([`facts`](super::facts)). A descriptor about which the kernel
    /// reports an error has no facts, and proves nothing.
    ///
    /// # Errors
    ///
    /// This process is short of something that the answer needs ([`Side::Receiver`]). The descriptor is closed: it
    /// counts as one that could not be received.
    //= SM2-TRN-011
    pub fn new(fd: OwnedFd) -> io::Result<Self> {
        match facts(fd.as_fd()) {
            Err(error) if blame(&error) == Side::Receiver => Err(error),
            facts => Ok(Self {
                facts: facts.unwrap_or_default(),
                fd,
            }),
        }
    }

    /// The facts, as the protocol's machines take them.
    #[must_use]
    pub const fn facts(&self) -> FdFacts {
        self.facts
    }

    /// Proves that neither the bytes nor the size can ever change.
    ///
    /// # Errors
    ///
    /// See [`VerifyError`]; the descriptor is closed then.
    pub fn into_sealed(self) -> Result<SealedFile, VerifyError> {
        self.prove(Seals::SEALED).map(SealedFile)
    }

    /// Proves that the size can never change, and that only mappings made before the seals write.
    ///
    /// # Errors
    ///
    /// As [`into_sealed`](Self::into_sealed).
    pub fn into_pooled(self) -> Result<PooledFile, VerifyError> {
        self.prove(Seals::POOLED).map(PooledFile)
    }

    /// Proves that the size can never change.
    ///
    /// # Errors
    ///
    /// As [`into_sealed`](Self::into_sealed).
    pub fn into_ring(self) -> Result<RingFile, VerifyError> {
        self.prove(Seals::RING).map(RingFile)
    }

    fn prove(self, needed: Seals) -> Result<FixedSize, VerifyError> {
        let FdFacts {
            regular,
            size_bytes,
            seals,
        } = self.facts;
        if !regular {
            return Err(VerifyError::NotAMemfd);
        }
        if !seals.contains(needed) {
            return Err(VerifyError::SealsMissing { seals, needed });
        }
        // `facts` read the size after the seals, so this size is the last one.
        let fd = self.fd;
        Ok(FixedSize { fd, size_bytes })
    }
}

impl From<InspectedFd> for OwnedFd {
    fn from(inspected: InspectedFd) -> Self {
        inspected.fd
    }
}

/// A memfd whose size never changes: what all proofs have in common.
#[derive(Debug)]
struct FixedSize {
    fd: OwnedFd,
    size_bytes: u64,
}

macro_rules! proof {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug)]
        pub struct $name(FixedSize);

        impl $name {
            /// The size of the file, which never changes.
            #[must_use]
            pub const fn size_bytes(&self) -> u64 {
                self.0.size_bytes
            }
        }

        impl AsFd for $name {
            fn as_fd(&self) -> BorrowedFd<'_> {
                self.0.fd.as_fd()
            }
        }

        impl From<$name> for OwnedFd {
            fn from(file: $name) -> Self {
                file.0.fd
            }
        }
    };
}

proof! {
    /// Proof that a memfd is immutable for all processes, its author included.
    SealedFile
}
proof! {
    /// Proof that a memfd keeps its size, and that no process can map it for writing any more.
    ///
    /// Its author keeps a writable mapping by design, so this does not prove that bytes stay.
    PooledFile
}
proof! {
    /// Proof that a memfd keeps its size. Every process that has it may write.
    RingFile
}

/// Why a descriptor does not prove what a mapping needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VerifyError {
    /// It is not a regular file of the kernel's memory file system.
    #[error("the descriptor is not a memfd")]
    NotAMemfd,
    /// Its author could still change what the seals have to forbid.
    #[error("the memfd has the seals {:#x} and needs {:#x}", seals.0, needed.0)]
    SealsMissing {
        /// The seals of the file.
        seals: Seals,
        /// The seals that the mapping needs.
        needed: Seals,
    },
}
