use std::{io, sync::Arc};

use sm2_node::{
    WaitError, WaitSet,
    clock::{self, Clock, DomainTime},
};
use sm2_proto::Instant;

use crate::{
    catalogue::Snapshot,
    connection::{AcceptError, Gone},
    frame,
    outbox::{Frame, Outbox},
    protocol::{Level, ToViewer},
    shared::Shared,
};

/// The sources that wake the thread of a viewer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// The viewer has sent something.
    Readable,
    /// The socket takes bytes again.
    Writable,
    /// The domain has changed.
    News,
    /// A subscription has messages.
    Topic(u32),
    /// A call has ended.
    Call(u64),
    /// The viewer gets the time of the domain.
    Tick,
}

/// The reason for the end of a viewer's thread.
#[derive(Debug, thiserror::Error)]
pub(crate) enum End {
    #[error(transparent)]
    Accept(#[from] AcceptError),
    #[error(transparent)]
    Gone(#[from] Gone),
    #[error("the time of the domain is another one now: the viewer connects again")]
    OtherClock,
    #[error("the server ends")]
    Shutdown,
    #[error("the operating system refuses a resource: {0}")]
    System(io::Error),
}

impl From<io::Error> for End {
    fn from(error: io::Error) -> Self {
        Self::System(error)
    }
}

impl From<WaitError> for End {
    fn from(error: WaitError) -> Self {
        match error {
            WaitError::Shutdown => Self::Shutdown,
            WaitError::Io(source) => Self::System(source),
            other => Self::System(io::Error::other(other)),
        }
    }
}

/// The parts of a viewer that its subscriptions, calls and publications use.
pub(super) struct Context {
    pub(super) shared: Arc<Shared>,
    pub(super) set: WaitSet<'static, Source>,
    pub(super) outbox: Outbox,
    /// The state of the domain that the viewer knows.
    pub(super) snapshot: Arc<Snapshot>,
    /// The clock of a domain with simulated time.
    pub(super) clock: Option<Clock>,
}

impl Context {
    /// The domain time when a message was published.
    pub(super) fn time_of(&self, published: Instant) -> DomainTime {
        match self.clock.as_ref().and_then(Clock::reading) {
            Some(reading) => reading.time(published),
            None => {
                let age_ns = sm2_node::now().0.saturating_sub(published.0);
                DomainTime(clock::wall_time().0.saturating_sub(age_ns))
            }
        }
    }

    /// Puts a message in JSON into the outbox.
    pub(super) fn send(&mut self, message: &ToViewer<'_>) -> Result<(), End> {
        // All of its keys are texts, so it has a form in JSON.
        let text = serde_json::to_string(message).unwrap_or_default();
        self.control(frame::text(&text))
    }

    /// Puts a control frame into the outbox.
    pub(super) fn control(&mut self, frame: Frame) -> Result<(), End> {
        Ok(self.outbox.control(frame).map_err(Gone::from)?)
    }

    /// Tells the person at the viewer that something is wrong.
    pub(super) fn complain(&mut self, level: Level, message: String) -> Result<(), End> {
        self.send(&ToViewer::Status { level, message })
    }
}
