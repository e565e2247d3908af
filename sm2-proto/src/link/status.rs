//! The outcome of a call, as its reply states it.

/// The outcome of a call (SM2-SRV-002).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u16)]
pub enum Status {
    /// The payload is the reply.
    #[default]
    Ok = 0,
    /// The server failed; the payload says why, in UTF-8.
    Failed = 1,
    /// The client cancelled the call; the reply has no payload.
    Cancelled = 2,
    /// The call's deadline passed; the reply has no payload.
    DeadlinePassed = 3,
}

impl Status {
    /// Every status, ordered by number.
    pub const ALL: [Self; 4] = [
        Self::Ok,
        Self::Failed,
        Self::Cancelled,
        Self::DeadlinePassed,
    ];

    /// Whether a reply with this status may have a payload.
    #[must_use]
    pub const fn has_payload(self) -> bool {
        matches!(self, Self::Ok | Self::Failed)
    }

    //= SM2-SRV-002
    pub(super) fn from_number(number: u16) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|status| *status as u16 == number)
    }
}
