//! The checksums of MCAP.

use mcap::{McapError, McapResult};

/// Whether a checksum is right. 0: the writer computed none.
pub(crate) const fn is_right(saved: u32, calculated: u32) -> bool {
    saved == 0 || saved == calculated
}

/// Compares the checksum of a chunk with that of its records.
pub(crate) const fn verify_crc(saved: u32, calculated: u32) -> McapResult<()> {
    match is_right(saved, calculated) {
        true => Ok(()),
        false => Err(McapError::BadChunkCrc { saved, calculated }),
    }
}
