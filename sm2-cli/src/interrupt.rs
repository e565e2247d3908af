//! Ctrl-C and SIGTERM: they end a wait, and the command ends at its next step.
#![allow(
    clippy::disallowed_types,
    reason = "the signal handlers of signal-hook write these types"
)]

use std::{
    io,
    os::{
        fd::{AsFd, BorrowedFd},
        unix::net::UnixStream,
    },
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
    low_level::pipe,
};

/// The exit status of a program that a signal ended is this much more than the signal.
const STATUS_OF_SIGNALS: i32 = 128;

/// The signal that asks the command to end, and a descriptor that becomes readable when it comes.
///
/// A command checks for the signal between two steps and ends cleanly. A second signal ends the process at
/// once, even if the command is stuck.
#[derive(Debug)]
pub(crate) struct Interrupt {
    signal: Arc<AtomicUsize>,
    /// Never read, so that it stays readable after a signal.
    pipe: UnixStream,
}

/// The signal that ended a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stopped(usize);

impl Interrupt {
    /// Catches SIGINT and SIGTERM from now on. Must be called once per process only.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn install() -> io::Result<Self> {
        let signal = Arc::new(AtomicUsize::new(0));
        let again = Arc::new(AtomicBool::new(false));
        let (pipe, written_by_handler) = UnixStream::pair()?;
        for (number, value) in [(SIGINT, SIGINT as usize), (SIGTERM, SIGTERM as usize)] {
            // The handlers run in this order, so the number is stored before the pipe wakes the command.
            let status = STATUS_OF_SIGNALS + number;
            flag::register_conditional_shutdown(number, status, Arc::clone(&again))?;
            flag::register(number, Arc::clone(&again))?;
            flag::register_usize(number, Arc::clone(&signal), value)?;
            pipe::register(number, written_by_handler.try_clone()?)?;
        }
        Ok(Self { signal, pipe })
    }

    /// The signal that came, if one did.
    pub(crate) fn signal(&self) -> Option<Stopped> {
        match self.signal.load(Ordering::Acquire) {
            0 => None,
            number => Some(Stopped(number)),
        }
    }
}

impl AsFd for Interrupt {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pipe.as_fd()
    }
}

impl Stopped {
    /// The exit status of a program that this signal ended, as shells expect it: 130 or 143.
    pub(crate) fn status(self) -> u8 {
        u8::try_from(STATUS_OF_SIGNALS as usize + self.0).unwrap_or(u8::MAX)
    }
}
