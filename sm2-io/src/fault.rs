//! Faults for tests: system calls of this crate that fail on request (feature `fault-injection`).
//!
//! An [`Injector`] makes the n-th call of one [`Call`] fail with an errno, without making the call, and
//! counts all calls. It acts on the threads that [install](Injector::install) it and on the background threads of the
//! nodes that they connect, so tests run in parallel. The
//! environment variable `SM2_FAULT=CALL:NTH:ERRNO[:TIMES]` makes one for the whole process, such as
//! `SM2_FAULT=Mmap:3:12` for the third `mmap` and `ENOMEM`; it acts on threads without an injector of
//! their own.
//!
//! The feature is for tests alone: no build that is shipped has it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use nix::libc;

pub use crate::syscall::Call;

/// The environment variable with the fault of a process.
pub const VARIABLE: &str = "SM2_FAULT";

/// A call that has to fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The kind of call.
    pub call: Call,
    /// The first call that fails, counted from 1.
    pub nth: u64,
    /// The calls in a row that fail.
    pub times: u64,
    /// The error.
    pub errno: i32,
}

/// Counts the calls of the threads that install it, and makes them fail.
#[derive(Clone, Debug, Default)]
pub struct Injector(Arc<Mutex<Plan>>);

#[derive(Debug, Default)]
struct Plan {
    faults: Vec<Fault>,
    counts: BTreeMap<Call, u64>,
    hits: u64,
}

thread_local! {
    static INSTALLED: RefCell<Option<Injector>> = const { RefCell::new(None) };
}

/// An injector acts on this thread until this value is dropped.
#[derive(Debug)]
#[must_use = "the injector acts until this value is dropped"]
pub struct Installed(Option<Injector>);

impl Injector {
    /// An injector that counts, and makes no call fail.
    #[must_use]
    pub fn counting() -> Self {
        Self::default()
    }

    /// An injector with a fault.
    #[must_use]
    pub fn new(fault: Fault) -> Self {
        let injector = Self::default();
        injector.set(Some(fault));
        injector
    }

    /// Replaces the faults, and counts from zero again.
    pub fn set(&self, faults: impl IntoIterator<Item = Fault>) {
        *self.plan() = Plan {
            faults: faults.into_iter().collect(),
            ..Plan::default()
        };
    }

    /// Makes the injector act on the current thread.
    pub fn install(&self) -> Installed {
        Installed(INSTALLED.replace(Some(self.clone())))
    }

    /// The calls so far, those that failed included.
    #[must_use]
    pub fn counts(&self) -> BTreeMap<Call, u64> {
        self.plan().counts.clone()
    }

    /// The calls that failed.
    #[must_use]
    pub fn hits(&self) -> u64 {
        self.plan().hits
    }

    fn plan(&self) -> std::sync::MutexGuard<'_, Plan> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn next(&self, call: Call) -> Option<i32> {
        let mut plan = self.plan();
        let count = plan.counts.entry(call).or_default();
        *count += 1;
        let number = *count;
        let is_due =
            |it: &&Fault| it.call == call && number >= it.nth && number - it.nth < it.times;
        let errno = plan.faults.iter().find(is_due)?.errno;
        plan.hits += 1;
        Some(errno)
    }
}

impl Drop for Installed {
    fn drop(&mut self) {
        INSTALLED.set(self.0.take());
    }
}

/// The body of a thread where the injector of the current thread acts, too.
pub(crate) fn inherited<T>(body: impl FnOnce() -> T) -> impl FnOnce() -> T {
    let injector = INSTALLED.with_borrow(Clone::clone);
    move || {
        let _installed = injector.map(|it| it.install());
        body()
    }
}

/// Counts a call of this thread. Returns the errno that it has to fail with.
pub(crate) fn next(call: Call) -> Option<i32> {
    // A thread that is ending has no injector any more.
    let installed = INSTALLED.try_with(|it| it.borrow().clone()).ok().flatten();
    installed.as_ref().or(of_process())?.next(call)
}

/// # Panics
///
/// If the environment variable names no fault: a test that injects nothing by mistake would pass.
fn of_process() -> Option<&'static Injector> {
    static OF_PROCESS: OnceLock<Option<Injector>> = OnceLock::new();
    let made = OF_PROCESS.get_or_init(|| {
        let text = std::env::var(VARIABLE).ok()?;
        let fault = Fault::parse(&text);
        let fault =
            fault.unwrap_or_else(|| panic!("{VARIABLE}={text}: use CALL:NTH:ERRNO[:TIMES]"));
        Some(Injector::new(fault))
    });
    made.as_ref()
}

impl Fault {
    /// Parses `CALL:NTH:ERRNO[:TIMES]`, with the name of a [`Call`] and numbers.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split(':');
        let name = parts.next()?;
        let call = Call::ALL.into_iter().find(|it| format!("{it:?}") == name)?;
        let nth = parts.next()?.parse().ok()?;
        let errno = parts.next()?.parse().ok()?;
        let times = parts.next().map_or(Some(1), |it| it.parse().ok())?;
        parts.next().is_none().then_some(Self {
            call,
            nth,
            times,
            errno,
        })
    }
}

/// A shortage of descriptors or memory.
const SHORT: &[i32] = &[libc::EMFILE, libc::ENFILE, libc::ENOMEM];
const MEMORY: &[i32] = &[libc::ENOMEM];

impl Call {
    /// The errors that the kernel can report for this call although its arguments are right.
    #[must_use]
    pub const fn errnos(self) -> &'static [i32] {
        match self {
            Self::Socket | Self::SocketPair => {
                &[libc::EMFILE, libc::ENFILE, libc::ENOMEM, libc::ENOBUFS]
            }
            Self::Accept => &[
                libc::EMFILE,
                libc::ENFILE,
                libc::ENOMEM,
                libc::ENOBUFS,
                libc::ECONNABORTED,
                libc::EINTR,
            ],
            Self::Connect => &[libc::EAGAIN, libc::ECONNREFUSED, libc::ENOENT, libc::ENOMEM],
            Self::SendMsg => &[
                libc::EAGAIN,
                libc::EINTR,
                libc::ENOBUFS,
                libc::ENOMEM,
                libc::ETOOMANYREFS,
            ],
            Self::RecvMsg => &[libc::EINTR, libc::ENOBUFS, libc::ENOMEM],
            Self::EpollCreate
            | Self::EventFd
            | Self::TimerCreate
            | Self::MemfdCreate
            | Self::PidfdOpen => SHORT,
            Self::Dup => &[libc::EMFILE],
            Self::EpollCtl => &[libc::ENOMEM, libc::ENOSPC],
            Self::EpollWait | Self::Poll => &[libc::EINTR, libc::ENOMEM],
            Self::AddSeals => &[libc::EBUSY, libc::ENOMEM],
            Self::Truncate | Self::Allocate | Self::Write => {
                &[libc::EINTR, libc::ENOSPC, libc::ENOMEM]
            }
            Self::Mmap => &[libc::ENOMEM, libc::ENFILE],
            Self::Advise | Self::Lock => &[libc::ENOMEM, libc::EAGAIN],
            Self::Open => &[libc::EMFILE, libc::ENFILE, libc::ENOMEM, libc::EACCES],
            Self::FileLock => &[libc::EINTR, libc::ENOLCK],
            Self::Bind | Self::Unlink | Self::Rename | Self::Mkdir | Self::Chmod => {
                &[libc::ENOMEM, libc::ENOSPC, libc::EACCES]
            }
            Self::Read => &[libc::EINTR, libc::ENOMEM],
            Self::SetScheduler => &[libc::EPERM],
            Self::UdpBind => &[libc::EMFILE, libc::ENFILE, libc::ENOBUFS, libc::ENOMEM],
            // Without EAGAIN: after one, the runtime waits for an edge, which only the kernel's own EAGAIN brings.
            Self::UdpSend | Self::UdpRecv => &[libc::ENOBUFS, libc::ENOMEM],
            Self::FcntlFlags
            | Self::GetSeals
            | Self::GetSockOpt
            | Self::SetSockOpt
            | Self::Stat
            | Self::Ioctl
            | Self::Listen => MEMORY,
            // Of valid arguments they report nothing.
            Self::Shutdown | Self::TimerSet | Self::GetLimit | Self::Seek => &[],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nth_call_fails_and_no_other() {
        let injector = Injector::new(Fault {
            call: Call::EventFd,
            nth: 2,
            times: 2,
            errno: libc::EMFILE,
        });
        let made: Vec<_> = {
            let _installed = injector.install();
            (0..5).map(|_| crate::Waker::new().is_ok()).collect()
        };
        assert_eq!(made, [true, false, false, true, true]);
        assert!(crate::Waker::new().is_ok());
        assert_eq!(injector.hits(), 2);
        assert_eq!(injector.counts()[&Call::EventFd], 5);
    }

    #[test]
    fn a_thread_of_the_library_has_the_injector_of_its_parent() {
        let injector = Injector::counting();
        let make = || crate::Waker::new().is_ok();
        let installed = injector.install();
        let thread = crate::spawn_without_signals("child".to_owned(), make).unwrap();
        assert!(thread.join().unwrap());
        drop(installed);
        let thread = crate::spawn_without_signals("other".to_owned(), make).unwrap();
        assert!(thread.join().unwrap());
        assert_eq!(injector.counts()[&Call::EventFd], 1);
    }

    #[test]
    fn the_variable_names_a_fault() {
        let fault = Fault::parse("Mmap:3:12").expect("a fault");
        assert_eq!((fault.call, fault.nth), (Call::Mmap, 3));
        assert_eq!((fault.errno, fault.times), (12, 1));
        assert_eq!(Fault::parse("Mmap:3:12:4").map(|it| it.times), Some(4));
        for wrong in ["", "Mmap", "mmap:3:12", "Mmap:3:12:4:5", "Mmap:x:12"] {
            assert_eq!(Fault::parse(wrong), None, "{wrong}");
        }
    }
}
