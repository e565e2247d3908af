//! A received datagram, as a driver hands it to a machine.

use crate::{FdFacts, Violation, limits::DATAGRAM_MAX};

/// The result of one read of a socket. The descriptors themselves stay with the driver, which
/// closes them unless an output of the machine asks for them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Datagram<'a> {
    /// The bytes; never empty (an empty read is the end of the stream).
    pub bytes: &'a [u8],
    /// The facts about each descriptor that came with the datagram.
    pub fds: &'a [FdFacts],
    /// `MSG_TRUNC`: the datagram was longer than the buffer.
    pub data_truncated: bool,
    /// `MSG_CTRUNC`: this process had no free descriptor for some of those that were sent.
    pub control_truncated: bool,
}

impl<'a> Datagram<'a> {
    /// A datagram without descriptors.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            fds: &[],
            data_truncated: false,
            control_truncated: false,
        }
    }

    /// Makes the checks that come before the first byte is read.
    //= SM2-TRN-004
    pub(crate) fn check(&self) -> Result<(), Violation> {
        if self.data_truncated || self.bytes.len() > DATAGRAM_MAX {
            return Err(violation!(FrameTooLong, "SM2-TRN-004"));
        }
        Ok(())
    }

    /// Checks that a frame carries exactly as many descriptors as its type names, as far as this
    /// process could receive them.
    //= SM2-TRN-010, SM2-TRN-011
    pub(crate) fn check_fds(&self, expected: usize) -> Result<(), Violation> {
        if self.has_lost_fds(expected) || (self.fds.len() == expected && !self.control_truncated) {
            Ok(())
        } else {
            Err(violation!(FdCount, "SM2-TRN-010"))
        }
    }

    /// Whether this process lost descriptors of a frame whose type names this many. If as many
    /// came, the sender sent more.
    //= SM2-TRN-011
    pub(crate) const fn has_lost_fds(&self, expected: usize) -> bool {
        self.control_truncated && self.fds.len() < expected
    }
}
