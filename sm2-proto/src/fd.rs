//! The facts that a driver asks the kernel about a descriptor that came with a frame.
//!
//! The machines never see a descriptor. The driver asks the kernel
//! (`fstat`, `F_GET_SEALS`) and hands over these facts; the machine decides
//! whether such a descriptor may be mapped.

/// The seals that `fcntl(F_GET_SEALS)` reports, as the kernel's bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Seals(pub u32);

impl Seals {
    /// `F_SEAL_SEAL`: no seal can be added or removed any more.
    pub const SEAL: Self = Self(0x1);
    /// `F_SEAL_SHRINK`: the file cannot become smaller.
    pub const SHRINK: Self = Self(0x2);
    /// `F_SEAL_GROW`: the file cannot become larger.
    pub const GROW: Self = Self(0x4);
    /// `F_SEAL_WRITE`: no process, its author included, can write any more.
    pub const WRITE: Self = Self(0x8);
    /// `F_SEAL_FUTURE_WRITE`: only mappings that exist already can write.
    pub const FUTURE_WRITE: Self = Self(0x10);

    /// The seals of a sealed message's file (SPEC, payload form *sealed*).
    pub const SEALED: Self = Self(0x1 | 0x2 | 0x4 | 0x8);
    /// The seals of a shared segment (SPEC, payload form *pooled*).
    pub const POOLED: Self = Self(0x1 | 0x2 | 0x4 | 0x10);

    /// The seals of a ring's file (SPEC, the ring lane).
    pub const RING: Self = Self(0x1 | 0x2 | 0x4);

    /// Whether all seals of `needed` are set. More seals do no harm.
    #[must_use]
    pub const fn contains(self, needed: Self) -> bool {
        self.0 & needed.0 == needed.0
    }
}

/// The facts about one received descriptor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct FdFacts {
    /// `S_ISREG`: a memfd is a regular file; sockets, pipes and devices are not.
    pub regular: bool,
    /// `st_size`, read after the seals: a size is only stable once it is sealed.
    pub size_bytes: u64,
    /// The seals; empty if the kernel answers that the file cannot have any.
    pub seals: Seals,
}
