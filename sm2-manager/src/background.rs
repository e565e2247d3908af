//! A Manager on a thread of its own.

use std::{
    path::{Path, PathBuf},
    thread::{self, JoinHandle},
};

use crate::{Manager, Options, RunError, StartError, Stopper};

/// A Manager that runs on its own thread until it is stopped or dropped.
#[derive(Debug)]
pub struct Background {
    path: PathBuf,
    stopper: Stopper,
    thread: Option<JoinHandle<Result<(), RunError>>>,
}

impl Background {
    /// Claims the socket at `path` and serves it. When this returns, nodes can connect.
    ///
    /// # Errors
    ///
    /// As [`Manager::bind`]; also if no thread can be made.
    pub fn start(path: &Path, options: Options) -> Result<Self, StartError> {
        let manager = Manager::bind(path, options)?;
        let stopper = manager.stopper();
        let thread = thread::Builder::new()
            .name("sm2-manager".into())
            .spawn(move || manager.run())
            .map_err(|source| StartError::Io {
                action: "start a thread",
                source,
            })?;
        Ok(Self {
            path: path.to_owned(),
            stopper,
            thread: Some(thread),
        })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Says goodbye to every node, removes the socket, and waits for the thread.
    ///
    /// # Errors
    ///
    /// What [`Manager::run`] ended with.
    pub fn stop(mut self) -> Result<(), RunError> {
        self.join()
    }

    fn join(&mut self) -> Result<(), RunError> {
        self.stopper.stop();
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            // A panic of the loop is the loop's; it is passed on, not swallowed.
            Some(Err(panic)) if !thread::panicking() => std::panic::resume_unwind(panic),
            Some(Err(_)) | None => Ok(()),
        }
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        if let Err(error) = self.join() {
            tracing::warn!(%error, "the Manager's loop had failed");
        }
    }
}
