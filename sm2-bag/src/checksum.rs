//! The checksums of MCAP.

/// Whether a checksum is right. 0: the writer computed none.
pub(crate) const fn is_right(saved: u32, calculated: u32) -> bool {
    saved == 0 || saved == calculated
}
