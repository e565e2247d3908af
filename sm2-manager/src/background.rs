//! A Manager on a thread of its own.

use std::{
    mem,
    path::{Path, PathBuf},
    thread::{self, JoinHandle},
};

use sm2_io::Maker;

use crate::{
    HandOver, Manager, Options, Outcome, PolicyReloader, RunError, Standby, StartError, Stopper,
};

/// A Manager that runs on its own thread. Dropping this handle stops it.
///
/// The Manager ends with this process. A child that was made by `fork(2)` keeps neither the domain nor its sessions,
/// and may drop its copy of this handle.
#[derive(Debug)]
pub struct Background {
    path: PathBuf,
    stopper: Stopper,
    hand_over: HandOver,
    policy_reload: PolicyReloader,
    thread: Option<JoinHandle<Result<(), RunError>>>,
    /// The process that has the thread.
    maker: Maker,
}

impl Background {
    /// Claims the socket at `path` and starts serving it. Nodes can connect as soon as this returns.
    ///
    /// A [hand-over](Self::hand_over) to another Manager ends the thread.
    ///
    /// # Errors
    ///
    /// As for [`Manager::bind`]; also if the thread cannot be created.
    pub fn start(path: &Path, options: Options) -> Result<Self, StartError> {
        let manager = Manager::bind(path, options)?;
        let handles = (
            manager.stopper(),
            manager.hand_over(),
            manager.policy_reload(),
        );
        Self::spawn(path, handles, move || manager.run().map(drop))
    }

    /// Ensures that a Manager serves the domain for as long as this handle lives: claims the socket at `path`
    /// and serves it, or stands by while another Manager serves. Nodes can connect as soon as this returns.
    ///
    /// After a [hand-over](Self::hand_over), this Manager stands by for its successor.
    ///
    /// # Errors
    ///
    /// As for [`Standby::start`]; also if the thread cannot be created.
    pub fn start_or_stand_by(path: &Path, options: Options) -> Result<Self, StartError> {
        let mut standby = Standby::start(path, options)?;
        let handles = (
            standby.stopper(),
            standby.hand_over(),
            standby.policy_reload(),
        );
        Self::spawn(path, handles, move || {
            while standby.run(|_| {})? == Outcome::HandedOver {}
            Ok(())
        })
    }

    fn spawn(
        path: &Path,
        (stopper, hand_over, policy_reload): (Stopper, HandOver, PolicyReloader),
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
            policy_reload,
            thread: Some(thread),
            maker: Maker::this_process(),
        })
    }

    /// The socket's path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns a handle that makes this Manager hand over the domain to another one.
    #[must_use]
    pub fn hand_over(&self) -> HandOver {
        self.hand_over.clone()
    }

    /// Returns a handle that makes this Manager read the access policy of the domain again.
    #[must_use]
    pub fn policy_reload(&self) -> PolicyReloader {
        self.policy_reload.clone()
    }

    /// Stops the Manager and waits for its thread. A Manager that serves says goodbye to every node and
    /// removes its socket.
    ///
    /// # Errors
    ///
    /// The error that [`Manager::run`] ended with.
    pub fn stop(mut self) -> Result<(), RunError> {
        self.join()
    }

    fn join(&mut self) -> Result<(), RunError> {
        if self.maker.is_parent() {
            // The thread is that of the parent: it can be neither stopped nor joined here.
            mem::forget(self.thread.take());
            return Ok(());
        }
        self.stopper.stop();
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            // A panic of the loop is passed on to the caller.
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

#[cfg(test)]
mod tests {
    use std::panic;

    use super::*;
    use crate::handles::Handles;

    /// A Manager whose loop panics.
    fn broken() -> Background {
        let handles = Handles::new().expect("eventfds");
        let handles = (
            handles.stopper(),
            handles.hand_over(),
            handles.policy_reload(),
        );
        let path = Path::new("domain.sock");
        Background::spawn(path, handles, || panic!("the loop")).expect("a thread")
    }

    fn text(panic: Box<dyn std::any::Any + Send>) -> &'static str {
        panic.downcast_ref::<&str>().expect("a text")
    }

    #[test]
    fn a_panic_of_the_loop_reaches_the_program() {
        let stopped = panic::catch_unwind(|| broken().stop());
        assert_eq!(text(stopped.expect_err("a panic")), "the loop");
        let dropped = panic::catch_unwind(|| drop(broken()));
        assert_eq!(text(dropped.expect_err("a panic")), "the loop");
    }

    /// A second panic would abort the program.
    #[test]
    fn a_panic_of_the_loop_ends_no_program_that_panics_already() {
        let caller = panic::catch_unwind(|| {
            let _dropped = broken();
            panic!("the caller");
        });
        assert_eq!(text(caller.expect_err("a panic")), "the caller");
    }
}
