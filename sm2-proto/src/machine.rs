//! The contract that every machine of this crate keeps: [`Machine`].

use alloc::collections::VecDeque;
use core::{convert::Infallible, fmt};

use crate::Instant;

/// A protocol as a state machine without I/O, a clock or descriptors.
///
/// Its driver owns the sockets and the clock and repeats these steps:
///
/// 1. Feed one input with [`handle`](Self::handle).
/// 2. Call [`poll`](Self::poll) and carry out each output until it returns `None`.
/// 3. Ask [`deadline`](Self::deadline) and sleep until then, or until something happens.
///
/// The driver drains all outputs before it feeds the next input, with these exceptions:
///
/// | machine | inputs that are legal while outputs wait |
/// | --- | --- |
/// | `manager::Manager` | `LinkFailed` |
/// | `node::Node`, `link::Link` | all but `Datagram`, because outputs refer to the datagram just handled |
/// | `gateway::router::Router` | `Taken` |
/// | `gateway::discovery::Discovery` | `Failed` |
/// | `gateway::session::PeerSession`, `gateway::schedule::Schedule`, `lockstep::Conductor` | none |
/// | `lockstep::Member` | none; it has one output at a time |
///
/// A debug assertion in `handle` checks this. The exceptions report that the output just polled
/// could not be carried out, or are commands that a driver gives while it carries out an output.
pub trait Machine {
    /// Events from outside, and the commands of the machine's owner.
    type Input<'a>;
    /// Work for the driver, and events for the machine's owner. A closed enum: one place in each
    /// driver matches it exhaustively.
    type Output;
    /// The reason why the machine ended; [`Infallible`] if it never ends.
    type End;
    /// How the machine's owner can break the contract.
    type Misuse;

    /// Feeds one input.
    ///
    /// # Errors
    /// [`Error::Misuse`]: this input is not legal now, and nothing has changed.
    /// [`Error::Ended`]: the machine has ended, perhaps because of this very input. It answers
    /// every later input with the same reason. For a node, this is the end of a session, and the
    /// input that begins the next session is taken.
    fn handle(
        &mut self,
        now: Instant,
        input: Self::Input<'_>,
    ) -> Result<(), Error<Self::End, Self::Misuse>>;

    /// Returns the next output; `None` once all are drained.
    fn poll(&mut self) -> Option<Self::Output>;

    /// The time when the driver feeds a tick if nothing else happens earlier; `None` if the
    /// machine has no timer running.
    fn deadline(&self) -> Option<Instant>;
}

/// The reason why [`Machine::handle`] did not do what its input asked for.
///
/// A machine that serves many peers reports no violation here: it ends one session and goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Error<E, M> {
    /// The machine has ended for this reason, the first one that occurred.
    Ended(E),
    /// The machine's owner broke its contract; nothing has changed.
    Misuse(M),
}

/// The error of a machine that never ends.
pub type MisuseError<M> = Error<Infallible, M>;

/// Checks in debug builds that the driver has drained the outputs of the inputs before. Each
/// machine calls this in [`Machine::handle`], before each input that requires it: see [`Machine`].
#[track_caller]
pub(crate) fn debug_assert_drained<Output>(outputs: &VecDeque<Output>) {
    debug_assert!(
        outputs.is_empty(),
        "the outputs of the input before have to be polled first"
    );
}

impl<E, M> From<M> for Error<E, M> {
    fn from(misuse: M) -> Self {
        Self::Misuse(misuse)
    }
}

impl<E: fmt::Display, M: fmt::Display> fmt::Display for Error<E, M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ended(end) => end.fmt(f),
            Self::Misuse(misuse) => misuse.fmt(f),
        }
    }
}

impl<E, M> core::error::Error for Error<E, M>
where
    E: fmt::Debug + fmt::Display,
    M: fmt::Debug + fmt::Display,
{
}
