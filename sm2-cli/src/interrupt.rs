//! Ctrl-C, SIGTERM and SIGHUP: they end a wait, and the command ends at its next step.
#![allow(
    clippy::disallowed_types,
    reason = "the signal handlers of signal-hook write these types"
)]

use std::{
    io::{self, Read},
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
    consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ},
    flag,
    low_level::pipe,
};
use sm2_io::is_signal_ignored;

/// The exit status of a program that a signal ended is this much more than the signal.
const STATUS_OF_SIGNALS: i32 = 128;

/// The signal that asks the command to end, and a descriptor that becomes readable when it comes.
///
/// A command checks for the signal between two steps and ends cleanly. A second signal ends the process at
/// once, even if the command is stuck, unless the command [takes](Self::take) each signal itself.
#[derive(Debug)]
pub(crate) struct Interrupt {
    signal: Arc<AtomicUsize>,
    /// Whether a signal came before. `None` if the command takes each signal.
    again: Option<Arc<AtomicBool>>,
    written_by_handler: UnixStream,
    /// Readable after a signal, until the signal is [taken](Self::take).
    pipe: UnixStream,
}

/// A signal as a descriptor that is readable after it.
#[derive(Debug)]
pub(crate) struct SignalPipe(UnixStream);

/// Signals that do nothing to this process, and that its children get as usual.
#[derive(Debug)]
pub(crate) struct Ignored;

/// The signal that ended a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stopped(usize);

impl Interrupt {
    /// Catches SIGINT, SIGTERM and SIGHUP from now on, unless the process was started with SIGHUP ignored, as nohup(1)
    /// does. A file that grows beyond its limit gives an error instead of the signal SIGXFSZ. Must be called once per
    /// process only.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn install() -> io::Result<Self> {
        Self::with(Some(Arc::new(AtomicBool::new(false))))
    }

    /// As [`install`](Self::install), for a command that [takes](Self::take) each signal: none ends the process.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn install_each() -> io::Result<Self> {
        Self::with(None)
    }

    fn with(again: Option<Arc<AtomicBool>>) -> io::Result<Self> {
        let (pipe, written_by_handler) = UnixStream::pair()?;
        pipe.set_nonblocking(true)?;
        let interrupt = Self {
            signal: Arc::new(AtomicUsize::new(0)),
            again,
            written_by_handler,
            pipe,
        };
        interrupt.add(SIGINT)?;
        interrupt.add(SIGTERM)?;
        if !is_signal_ignored(SIGHUP) {
            interrupt.add(SIGHUP)?;
        }
        // Nobody looks at the flag.
        flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)))?;
        Ok(interrupt)
    }

    /// Lets one more signal end the command.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn add(&self, number: i32) -> io::Result<()> {
        // The handlers run in this order, so the number is stored before the pipe wakes the command.
        if let Some(again) = &self.again {
            let status = STATUS_OF_SIGNALS + number;
            flag::register_conditional_shutdown(number, status, Arc::clone(again))?;
            flag::register(number, Arc::clone(again))?;
        }
        flag::register_usize(number, Arc::clone(&self.signal), number as usize)?;
        pipe::register(number, self.written_by_handler.try_clone()?)?;
        Ok(())
    }

    /// The signal that came, if one did.
    pub(crate) fn signal(&self) -> Option<Stopped> {
        Stopped::from_number(self.signal.load(Ordering::Acquire))
    }

    /// The signal that came since the last call, if one did.
    pub(crate) fn take(&self) -> Option<Stopped> {
        // A signal that comes after this leaves the pipe readable.
        drain(&self.pipe);
        Stopped::from_number(self.signal.swap(0, Ordering::AcqRel))
    }
}

impl SignalPipe {
    /// Catches this signal from now on.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn install(signal: i32) -> io::Result<Self> {
        let (read, written_by_handler) = UnixStream::pair()?;
        read.set_nonblocking(true)?;
        pipe::register(signal, written_by_handler)?;
        Ok(Self(read))
    }

    /// Whether the signal has come since the last call.
    pub(crate) fn has_come(&self) -> bool {
        drain(&self.0)
    }
}

impl AsFd for SignalPipe {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

/// Reads all bytes. Returns whether there were some.
fn drain(mut pipe: &UnixStream) -> bool {
    let mut bytes = [0; 64];
    let mut some = false;
    while matches!(pipe.read(&mut bytes), Ok(len) if len > 0) {
        some = true;
    }
    some
}

impl Ignored {
    /// Lets SIGINT, SIGTERM and SIGHUP do nothing from now on.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn install() -> io::Result<Self> {
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            // Nobody looks at the flag.
            flag::register(signal, Arc::new(AtomicBool::new(false)))?;
        }
        Ok(Self)
    }
}

impl AsFd for Interrupt {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pipe.as_fd()
    }
}

impl Stopped {
    /// The signal of this number; 0 stands for none.
    pub(crate) fn from_number(number: usize) -> Option<Self> {
        (number != 0).then_some(Self(number))
    }

    /// The exit status of a program that this signal ended, as shells expect it: 129, 130 or 143.
    pub(crate) fn status(self) -> u8 {
        u8::try_from(STATUS_OF_SIGNALS as usize + self.0).unwrap_or(u8::MAX)
    }
}
