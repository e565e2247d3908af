//! The handle of a node's parameters.

use std::io;
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use super::changes::Changes;
use super::core::{Core, Parameter, Snapshot};
use super::error::{ParametersError, SetError};
use super::table::{Assignment, SetParameters, SetParametersResult};
use super::value::ParameterType;
use crate::{RecvError, Server, Shutdown, WaitError, WaitSet};

/// The parameters of a node, as long as this value or a clone of it exists. Dropping the last clone withdraws them:
/// other nodes do not see them any more, and each [`Parameter`] keeps its last value.
///
/// Made by [`ParametersBuilder`](super::ParametersBuilder), where the [module](super) has an example.
#[derive(Clone, Debug)]
pub struct Parameters {
    core: Arc<Core>,
    _thread: Option<Arc<ServingThread>>,
}

impl Parameters {
    /// Parameters whose changes the program handles.
    pub(super) const fn of_program(core: Arc<Core>) -> Self {
        Self {
            core,
            _thread: None,
        }
    }

    /// Parameters whose changes a thread accepts.
    pub(super) fn of_thread(
        core: Arc<Core>,
        server: Server<SetParameters, SetParametersResult>,
        node: &str,
    ) -> Result<Self, ParametersError> {
        let changes = Changes::new(server, Arc::clone(&core));
        let thread = ServingThread::start(changes, node);
        let thread = thread.map_err(ParametersError::Thread)?;
        Ok(Self {
            core,
            _thread: Some(Arc::new(thread)),
        })
    }

    /// All parameters at this moment.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        self.core.snapshot()
    }

    /// Sets a parameter, as another node would do: type, range and length are checked, and all who watch the
    /// parameters see the change.
    ///
    /// # Errors
    ///
    /// See [`SetError`].
    pub fn set<T: ParameterType>(
        &self,
        parameter: &Parameter<T>,
        value: T,
    ) -> Result<(), SetError> {
        let assignment = Assignment {
            name: parameter.name().to_owned(),
            value: value.into_value(),
        };
        self.core.set(&[assignment]).map(drop)
    }
}

/// A thread that accepts every change that type and range allow, so that a program without a loop has parameters as
/// well. Dropping this value ends the thread.
#[derive(Debug)]
struct ServingThread {
    thread: Option<JoinHandle<()>>,
    stop: Shutdown,
}

/// The kernel keeps 15 bytes of a thread's name.
const THREAD: &str = "sm2-parameters";

impl ServingThread {
    fn start(changes: Changes, node: &str) -> io::Result<Self> {
        let stop = Shutdown::new()?;
        let mut set = WaitSet::new()?;
        set.add(&changes, ())?;
        set.end_with(&stop)?;
        let node = node.to_owned();
        let thread = sm2_io::spawn_without_signals(THREAD.to_owned(), move || {
            if let Err(error) = serve(&mut set, &changes) {
                tracing::error!(%node, %error, "parameters cannot be set any more");
            }
        })?;
        Ok(Self {
            thread: Some(thread),
            stop,
        })
    }
}

impl Drop for ServingThread {
    fn drop(&mut self) {
        self.stop.request();
        let Some(thread) = self.thread.take() else {
            return;
        };
        // A `tracing` subscriber that owns the last handle drops it on the thread itself.
        if thread.thread().id() != thread::current().id() {
            let _ = thread.join();
        }
    }
}

/// Accepts changes until the thread is told to end.
fn serve(set: &mut WaitSet<'_, ()>, changes: &Changes) -> Result<(), RecvError> {
    loop {
        match set.wait() {
            Ok(_) => {}
            Err(WaitError::Io(error)) => return Err(RecvError::Io(error)),
            Err(_) => return Ok(()),
        }
        loop {
            match changes.try_next() {
                Ok(Some(change)) => {
                    change.accept();
                }
                Ok(None) => break,
                // The request of one client is lost.
                Err(error @ RecvError::Map { .. }) => tracing::warn!(%error, "parameters"),
                Err(error) => return Err(error),
            }
        }
    }
}
