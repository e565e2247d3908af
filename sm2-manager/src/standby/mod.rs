//! A Manager that waits for the end of another one.

mod session;

use std::{
    io,
    os::fd::AsFd,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use sm2_io::{DomainSocketError, SeqPacket, wait_readable};
use tracing::{info, warn};

use self::session::{Over, Session};
use crate::{HandOver, Manager, Options, Outcome, RunError, StartError, Stopper, handles::Handles};

/// How long somebody may hold the domain's lock when a standby starts, and not serve.
const LOCK_TIMEOUT: Duration = Duration::from_secs(5);

/// A Manager that serves its domain if nobody else does, and waits for the end of whoever does.
///
/// While another Manager serves, a standby is an ordinary node of the domain named
/// `sm2/standby/<pid>` (with `-2`, `-3`, … where that is taken). It does nothing until that
/// session ends; then it tries to take the domain's lock. Of several standbys one becomes the
/// Manager, and the others wait for its end in turn.
#[derive(Debug)]
pub struct Standby {
    path: PathBuf,
    options: Options,
    handles: Handles,
    /// None after a hand-over: somebody else serves.
    state: Option<State>,
}

/// What a [`Standby`] does now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// It is the domain's Manager.
    Serving,
    /// Another Manager is, and it waits for its end.
    StandingBy,
}

#[derive(Debug)]
enum State {
    Serving(Box<Manager>),
    StandingBy(Box<Session>),
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
    /// Claims the socket at `path`, or connects to the Manager that holds it. When this
    /// returns, nodes can connect there; if this is the Manager, they are served once
    /// [`run`](Self::run) is called.
    ///
    /// # Errors
    ///
    /// [`StartError::DomainSocket`] if the place is not fit; [`StartError::NobodyServes`] if
    /// somebody holds the domain, and is not to be connected to for 5 s;
    /// [`StartError::Io`] if descriptors ran out.
    pub fn start(path: &Path, options: Options) -> Result<Self, StartError> {
        let handles = Handles::new().map_err(StartError::io("make an eventfd"))?;
        let mut pause = Pause::new();
        let start = Instant::now();
        let state = loop {
            match take(path, &options, &handles)? {
                Ok(state) => break state,
                Err(source) if start.elapsed() > LOCK_TIMEOUT => {
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

    /// What it does, or will do once it runs.
    #[must_use]
    pub fn role(&self) -> Role {
        let state = self.state.as_ref();
        state.map_or(Role::StandingBy, State::role)
    }

    /// What ends [`run`](Self::run).
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        self.handles.stopper()
    }

    /// What makes it leave the domain to another Manager, if it serves.
    #[must_use]
    pub fn hand_over(&self) -> HandOver {
        self.handles.hand_over()
    }

    /// Serves and stands by, in turn, until a [`Stopper`] says so, or another Manager has
    /// taken over after [`HandOver::start`]; run it again to stand by for that one. `on` hears
    /// what it does now: at once, and whenever that has changed.
    ///
    /// A place that is not fit any more (a disk that is full, a folder that is gone) is tried
    /// again and again.
    ///
    /// # Errors
    ///
    /// [`RunError`] if the kernel does not let it wait.
    //= SM2-TRN-008
    pub fn run(&mut self, mut on: impl FnMut(Role)) -> Result<Outcome, RunError> {
        let mut pause = Pause::new();
        loop {
            let state = match self.state.take() {
                Some(state) => state,
                None => match self.take(&mut pause)? {
                    Some(state) => state,
                    None => return Ok(Outcome::Stopped),
                },
            };
            on(state.role());
            match state {
                State::Serving(manager) => return manager.run(),
                State::StandingBy(session) => {
                    info!(path = %self.path.display(), "standing by");
                    match session.sit(&self.handles)? {
                        Over::Stopped => return Ok(Outcome::Stopped),
                        Over::Ended => pause = Pause::new(),
                        // It took us in and threw us out, and may do so again.
                        Over::NotWelcomed => pause.wait(&self.handles)?,
                    }
                }
            }
        }
    }

    /// Tries until somebody serves; none if it is stopped before.
    fn take(&self, pause: &mut Pause) -> io::Result<Option<State>> {
        loop {
            if self.handles.is_stopped()? {
                return Ok(None);
            }
            match take(&self.path, &self.options, &self.handles) {
                Ok(Ok(state)) => return Ok(Some(state)),
                // Whoever has the lock is about to serve, or to end.
                Ok(Err(_)) => {}
                Err(error) => pause.warn(&error),
            }
            pause.wait(&self.handles)?;
        }
    }
}

/// Becomes the Manager, or connects to whoever is; else why that one cannot be connected to.
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
    let connected = SeqPacket::connect(path).map(Session::new);
    Ok(connected.map(|session| State::StandingBy(Box::new(session))))
}

/// Ever longer pauses: the kernel frees the lock of a process that was killed only some
/// moments after its sockets are closed.
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

    /// Waits; not longer than until the standby is stopped.
    fn wait(&mut self, handles: &Handles) -> io::Result<()> {
        wait_readable(&[handles.stop.as_fd()], Some(self.next))?;
        self.next = (self.next * 2).min(Self::LAST);
        Ok(())
    }

    /// Says what is in the way, once.
    fn warn(&mut self, error: &StartError) {
        let text = error.to_string();
        if self.warned.as_ref() != Some(&text) {
            warn!(%error, "cannot take over yet");
            self.warned = Some(text);
        }
    }
}
