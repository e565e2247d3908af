//! A Manager that stands by until another one ends.
//!
//! A standby holds no copy of the domain's state, so nothing can be out of date. It is an ordinary node that notices
//! the end of its session and takes the lock; a Manager that is started by hand an hour later does the same. The price
//! is one exchange with each node: two frames, and one for each interface and link.

mod node;

use std::{
    io,
    os::fd::AsFd,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use sm2_io::{DomainSocketError, SeqPacket, wait_readable};
use tracing::{info, warn};

use self::node::{Over, StandbyNode};
use crate::{
    HandOver, Manager, Options, Outcome, PolicyReloader, RunError, StartError, Stopper,
    handles::Handles,
};

/// How long the domain may be locked without being served when a standby starts.
const LOCK_TIMEOUT: Duration = Duration::from_secs(5);

/// Serves its domain when no other Manager does, and stands by otherwise.
///
/// While another Manager serves, a standby is an ordinary node of the domain named `sm2/standby/<pid>` (with
/// `-2`, `-3`, … if that name is taken). When its session ends, the standby tries to take the domain's lock.
/// One of several standbys becomes the Manager; the others stand by for it.
#[derive(Debug)]
pub struct Standby {
    path: PathBuf,
    options: Options,
    handles: Handles,
    /// `None` after a hand-over: another Manager serves.
    state: Option<State>,
}

/// The current role of a [`Standby`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// This process is the domain's Manager.
    Serving,
    /// Another Manager serves, and this process waits for its end.
    StandingBy,
}

#[derive(Debug)]
enum State {
    Serving(Box<Manager>),
    StandingBy(Box<StandbyNode>),
}

impl State {
    const fn role(&self) -> Role {
        match self {
            Self::Serving(_) => Role::Serving,
            Self::StandingBy(_) => Role::StandingBy,
        }
    }
}

impl Standby {
    /// Claims the socket at `path`, or connects to the Manager that holds it. Nodes can connect as soon as
    /// this returns. If this process is the Manager, it serves them once [`run`](Self::run) is called.
    ///
    /// # Errors
    ///
    /// [`StartError::Limit`] if a limit is wrong; [`StartError::DomainSocket`] if the path cannot be used;
    /// [`StartError::NobodyServes`] if another process holds the domain and accepts no connection for 5 s;
    /// [`StartError::Io`] if the process has no descriptors left.
    pub fn start(path: &Path, options: Options) -> Result<Self, StartError> {
        Self::start_within(path, options, LOCK_TIMEOUT)
    }

    fn start_within(path: &Path, options: Options, timeout: Duration) -> Result<Self, StartError> {
        let handles = Handles::new().map_err(StartError::io("make an eventfd"))?;
        let mut pause = Pause::new();
        let start = Instant::now();
        let state = loop {
            match take(path, &options, &handles)? {
                Ok(state) => break state,
                Err(source) if start.elapsed() > timeout => {
                    let path = path.to_owned();
                    return Err(StartError::NobodyServes { path, source });
                }
                Err(_) => pause.wait(&handles).map_err(StartError::io("wait"))?,
            }
        };
        Ok(Self {
            path: path.to_owned(),
            options,
            handles,
            state: Some(state),
        })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The current role, or the first role if [`run`](Self::run) has not been called yet.
    #[must_use]
    pub fn role(&self) -> Role {
        let state = self.state.as_ref();
        state.map_or(Role::StandingBy, State::role)
    }

    /// Returns a handle that stops [`run`](Self::run).
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        self.handles.stopper()
    }

    /// Returns a handle that makes this process hand over the domain to another Manager, if it serves.
    #[must_use]
    pub fn hand_over(&self) -> HandOver {
        self.handles.hand_over()
    }

    /// Returns a handle that makes this process, while it serves, read the access policy again.
    #[must_use]
    pub fn policy_reload(&self) -> PolicyReloader {
        self.handles.policy_reload()
    }

    /// Serves and stands by, in turn, until a [`Stopper`] stops it, or until another Manager has taken over
    /// after [`HandOver::start`]. Call it again to stand by for that Manager. It calls `on` with the role at
    /// the start and after each change.
    ///
    /// If the path cannot be used for a while (a full disk, a missing folder), it tries again.
    ///
    /// # Errors
    ///
    /// [`RunError`] if waiting for events fails.
    //= SM2-TRN-007
    pub fn run(&mut self, mut on: impl FnMut(Role)) -> Result<Outcome, RunError> {
        let mut pause = Pause::new();
        loop {
            let state = match self.state.take() {
                Some(state) => state,
                None => match self.take(&mut pause).map_err(RunError)? {
                    Some(state) => state,
                    None => return Ok(Outcome::Stopped),
                },
            };
            on(state.role());
            match state {
                State::Serving(manager) => return manager.run(),
                State::StandingBy(node) => {
                    info!(path = %self.path.display(), "standing by");
                    match node.sit(&self.handles).map_err(RunError)? {
                        Over::Stopped => return Ok(Outcome::Stopped),
                        Over::Ended => pause = Pause::new(),
                        // The Manager ended the session before WELCOME, and may do so again.
                        Over::NotWelcomed => pause.wait(&self.handles).map_err(RunError)?,
                    }
                }
            }
        }
    }

    /// Tries until some Manager serves; `None` if stopped before.
    fn take(&self, pause: &mut Pause) -> io::Result<Option<State>> {
        loop {
            if self.handles.is_stopped()? {
                return Ok(None);
            }
            match take(&self.path, &self.options, &self.handles) {
                Ok(Ok(state)) => return Ok(Some(state)),
                // The process that holds the lock is about to serve or to end.
                Ok(Err(_)) => {}
                Err(error) => pause.warn(&error),
            }
            pause.wait(&self.handles)?;
        }
    }
}

/// Becomes the Manager, or connects to the one that serves. The inner error says why connecting failed.
fn take(
    path: &Path,
    options: &Options,
    handles: &Handles,
) -> Result<io::Result<State>, StartError> {
    match Manager::bind_with(path, options, handles) {
        Ok(manager) => return Ok(Ok(State::Serving(Box::new(manager)))),
        Err(StartError::DomainSocket(DomainSocketError::Busy { .. })) => {}
        Err(error) => return Err(error),
    }
    let connected = SeqPacket::connect(path).map(StandbyNode::new);
    Ok(connected.map(|node| State::StandingBy(Box::new(node))))
}

/// Pauses of increasing length. After a process is killed, the kernel frees its lock some moments after it
/// closes its sockets.
struct Pause {
    next: Duration,
    warned: Option<String>,
}

impl Pause {
    const FIRST: Duration = Duration::from_micros(100);
    const LAST: Duration = Duration::from_millis(100);

    const fn new() -> Self {
        Self {
            next: Self::FIRST,
            warned: None,
        }
    }

    /// Waits for the pause, or until the standby is stopped.
    fn wait(&mut self, handles: &Handles) -> io::Result<()> {
        wait_readable(&[handles.stop.as_fd()], Some(self.next))?;
        self.next = (self.next * 2).min(Self::LAST);
        Ok(())
    }

    /// Logs the obstacle, unless it is the same as the last time.
    fn warn(&mut self, error: &StartError) {
        let text = error.to_string();
        if self.warned.as_ref() != Some(&text) {
            warn!(%error, "cannot take over yet; trying again");
            self.warned = Some(text);
        }
    }
}

#[cfg(test)]
mod tests {
    use sm2_io::DomainLock;

    use super::*;

    //= SM2-TRN-007 test
    #[test]
    fn a_lock_whose_holder_does_not_serve_in_time_is_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("domain.sock");
        let _lock = DomainLock::acquire(&path).expect("the lock");
        let timeout = Duration::from_millis(20);
        let error = Standby::start_within(&path, Options::default(), timeout);
        assert!(
            matches!(error, Err(StartError::NobodyServes { .. })),
            "{error:?}"
        );
    }

    #[test]
    fn pauses_double_up_to_a_tenth_of_a_second() {
        let handles = Handles::new().expect("eventfds");
        // The pauses end at once.
        handles.stopper().stop();
        let mut pause = Pause::new();
        let mut pauses = Vec::new();
        for _ in 0..12 {
            pauses.push(pause.next.as_micros());
            pause.wait(&handles).expect("a pause");
        }
        let doubled = (0..10).map(|it| 100 << it);
        assert_eq!(pauses, doubled.chain([100_000; 2]).collect::<Vec<_>>());
    }
}
