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
    /// `MSG_CTRUNC`: not all descriptors could be received.
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
    //= SM2-TRN-004, SM2-TRN-005
    pub(crate) fn check(&self) -> Result<(), Violation> {
        if self.data_truncated || self.bytes.len() > DATAGRAM_MAX {
            return Err(violation!(FrameTooLong, "SM2-TRN-004"));
        }
        if self.control_truncated {
            return Err(violation!(ControlTruncated, "SM2-TRN-005"));
        }
        Ok(())
    }

    /// Checks that a frame carries exactly as many descriptors as its type names.
    //= SM2-TRN-005
    pub(crate) fn check_fds(&self, expected: usize) -> Result<(), Violation> {
        if self.fds.len() == expected {
            Ok(())
        } else {
            Err(violation!(FdCount, "SM2-TRN-005"))
        }
    }
}
