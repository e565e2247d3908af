//! The actions of the model, and their text in a trace.

use std::fmt;

use super::Form;

/// One event. End 0 publishes or calls, end 1 subscribes or serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// An end's driver gets its socket, and sends OPEN.
    Begins(u8),
    /// An end reads its next frame, or the end of the stream.
    Reads(u8),
    /// An end's socket accepts the packet that it refused before.
    Flushes(u8),
    /// An application takes the next message.
    Takes(u8),
    /// An application releases the message of this number.
    GivesBack(u8, u64),
    /// The server replies to this call.
    Replies(u64, Form),
    /// A publication, or a call.
    Sends(Form),
    /// The publisher's deadline passes while it waits for room.
    Skips,
    /// The caller no longer wants the reply to this call.
    Cancels(u64),
    /// An end gives up this segment.
    Retires(u8, u32),
    /// A program closes its end.
    Closes(u8),
    /// The process of an end dies.
    Dies(u8),
}

impl Action {
    /// True if the action happens sooner or later without a choice.
    pub(super) const fn goes_on(self) -> bool {
        match self {
            Self::Begins(_)
            | Self::Reads(_)
            | Self::Flushes(_)
            | Self::Takes(_)
            | Self::GivesBack(..)
            | Self::Replies(..) => true,
            Self::Sends(_)
            | Self::Skips
            | Self::Cancels(_)
            | Self::Retires(..)
            | Self::Closes(_)
            | Self::Dies(_) => false,
        }
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Begins(at) => write!(f, "end {at} begins"),
            Self::Reads(at) => write!(f, "end {at} reads"),
            Self::Flushes(at) => write!(f, "the socket of end {at} takes what was kept"),
            Self::Takes(at) => write!(f, "end {at} takes a message"),
            Self::GivesBack(at, sequence) => write!(f, "end {at} gives message {sequence} back"),
            Self::Replies(call, form) => write!(f, "end 1 replies to call {call}, {form:?}"),
            Self::Sends(form) => write!(f, "end 0 sends, {form:?}"),
            Self::Skips => write!(f, "end 0 waits for room in vain"),
            Self::Cancels(call) => write!(f, "end 0 cancels call {call}"),
            Self::Retires(at, segment) => write!(f, "end {at} retires segment {segment}"),
            Self::Closes(at) => write!(f, "end {at} closes"),
            Self::Dies(at) => write!(f, "the process of end {at} dies"),
        }
    }
}
