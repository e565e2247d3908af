//! A Manager on a thread of its own.

use std::{
    path::{Path, PathBuf},
    thread::{self, JoinHandle},
};

use crate::{HandOver, Manager, Options, Outcome, RunError, Standby, StartError, Stopper};

/// A Manager that runs on its own thread until it is stopped or dropped.
#[derive(Debug)]
pub struct Background {
    path: PathBuf,
    stopper: Stopper,
    hand_over: HandOver,
    thread: Option<JoinHandle<Result<(), RunError>>>,
}

impl Background {
    /// Claims the socket at `path` and serves it. When this returns, nodes can connect.
    ///
    /// After a [hand-over](Self::hand_over) it does nothing any more.
    ///
    /// # Errors
    ///
    /// As [`Manager::bind`]; also if no thread can be made.
    pub fn start(path: &Path, options: Options) -> Result<Self, StartError> {
        let manager = Manager::bind(path, options)?;
        let (stopper, hand_over) = (manager.stopper(), manager.hand_over());
        Self::spawn(path, stopper, hand_over, move || manager.run().map(drop))
    }

    /// Makes sure that a Manager serves the domain, now and as long as this lives: claims the
    /// socket at `path` and serves it, or stands by while somebody else does. When this
    /// returns, nodes can connect.
    ///
    /// After a [hand-over](Self::hand_over) it stands by for its successor.
    ///
    /// # Errors
    ///
    /// As [`Standby::start`]; also if no thread can be made.
    pub fn start_or_stand_by(path: &Path, options: Options) -> Result<Self, StartError> {
        let mut standby = Standby::start(path, options)?;
        let (stopper, hand_over) = (standby.stopper(), standby.hand_over());
        Self::spawn(path, stopper, hand_over, move || {
            while standby.run(|_| {})? == Outcome::HandedOver {}
            Ok(())
        })
    }

    fn spawn(
        path: &Path,
        stopper: Stopper,
        hand_over: HandOver,
        run: impl FnOnce() -> Result<(), RunError> + Send + 'static,
    ) -> Result<Self, StartError> {
        let thread = thread::Builder::new().name("sm2-manager".into());
        let thread = thread
            .spawn(run)
            .map_err(StartError::io("start a thread"))?;
        Ok(Self {
            path: path.to_owned(),
            stopper,
            hand_over,
            thread: Some(thread),
        })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What makes it leave the domain to another Manager.
    #[must_use]
    pub fn hand_over(&self) -> HandOver {
        self.hand_over.clone()
    }

    /// Ends it, and waits for the thread. If it serves, it says goodbye to every node and
    /// removes the socket.
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
