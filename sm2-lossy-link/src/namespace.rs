//! Network namespaces without a name: the kernel takes one back when nobody has it any more, so a
//! process that is killed leaves none behind.

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

/// A network of its own: interfaces, addresses, routes, sockets. It lives as long as a clone of this,
/// a thread or process in it, or a socket that was made there.
#[derive(Clone, Debug)]
pub struct Namespace {
    handle: Arc<OwnedFd>,
}

impl Namespace {
    /// One in which there is nothing but a loopback that is down.
    ///
    /// # Errors
    /// The process may not (it takes `CAP_SYS_ADMIN`), or the kernel cannot.
    pub fn new() -> io::Result<Self> {
        // Only that thread moves, and it ends here.
        let handle = on_a_thread(|| {
            unshare(CloneFlags::CLONE_NEWNET)?;
            File::open("/proc/thread-self/ns/net")
        })?;
        Ok(Self {
            handle: Arc::new(handle?.into()),
        })
    }

    /// Does some work there: what sockets it makes and what processes it starts stay there.
    ///
    /// # Errors
    /// There is no thread for it, or the process may not go there any more.
    ///
    /// # Panics
    /// If the work does.
    pub fn enter<T: Send>(&self, work: impl FnOnce() -> T + Send) -> io::Result<T> {
        on_a_thread(|| {
            self.join()?;
            Ok(work())
        })?
    }

    /// Takes the thread that calls there, until it ends.
    pub(crate) fn join(&self) -> io::Result<()> {
        Ok(setns(&self.handle, CloneFlags::CLONE_NEWNET)?)
    }

    /// What other processes find it by, as long as this one lives.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        format!("/proc/{}/fd/{}", process::id(), self.handle.as_raw_fd()).into()
    }
}

/// Namespaces are of threads: one of its own keeps the caller where it is.
fn on_a_thread<T: Send>(work: impl FnOnce() -> T + Send) -> io::Result<T> {
    thread::scope(|scope| {
        let thread = thread::Builder::new().name("namespace".to_owned());
        match thread.spawn_scoped(scope, work)?.join() {
            Ok(done) => Ok(done),
            Err(reason) => panic::resume_unwind(reason),
        }
    })
}
