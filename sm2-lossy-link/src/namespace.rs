//! Network namespaces without names. The kernel removes a namespace that nothing refers to, so a killed
//! process leaves none behind.

use std::{
    fs::File,
    io,
    os::fd::{AsRawFd, OwnedFd},
    panic,
    path::PathBuf,
    process,
    sync::Arc,
    thread,
};

use nix::sched::{CloneFlags, setns, unshare};

/// A network namespace: interfaces, addresses, routes and sockets. It exists as long as a clone of
/// this handle, a thread or process in it, or a socket of it.
#[derive(Clone, Debug)]
pub struct Namespace {
    handle: Arc<OwnedFd>,
}

impl Namespace {
    /// Makes a namespace with only a loopback interface, which is down.
    ///
    /// # Errors
    /// The process lacks `CAP_SYS_ADMIN`, or the kernel does not support namespaces.
    pub fn new() -> io::Result<Self> {
        // `unshare` affects only the calling thread, which ends here.
        let handle = on_a_thread(|| {
            unshare(CloneFlags::CLONE_NEWNET)?;
            File::open("/proc/thread-self/ns/net")
        })?;
        Ok(Self {
            handle: Arc::new(handle?.into()),
        })
    }

    /// Calls `work` on a thread in the namespace: sockets and processes that it makes belong to it.
    ///
    /// # Errors
    /// The thread cannot be started, or may not enter the namespace.
    ///
    /// # Panics
    /// If the work does.
    pub fn enter<T: Send>(&self, work: impl FnOnce() -> T + Send) -> io::Result<T> {
        on_a_thread(|| {
            self.join()?;
            Ok(work())
        })?
    }

    /// Moves the calling thread into the namespace for the rest of its life.
    pub(crate) fn join(&self) -> io::Result<()> {
        Ok(setns(&self.handle, CloneFlags::CLONE_NEWNET)?)
    }

    /// The path that lets other processes open the namespace while this process runs.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        format!("/proc/{}/fd/{}", process::id(), self.handle.as_raw_fd()).into()
    }
}

/// Calls `work` on a thread of its own, since entering a namespace affects the whole thread.
fn on_a_thread<T: Send>(work: impl FnOnce() -> T + Send) -> io::Result<T> {
    thread::scope(|scope| {
        let thread = thread::Builder::new().name("namespace".to_owned());
        match thread.spawn_scoped(scope, work)?.join() {
            Ok(done) => Ok(done),
            Err(reason) => panic::resume_unwind(reason),
        }
    })
}
