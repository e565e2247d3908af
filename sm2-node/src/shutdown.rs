//! Ending all waits of a program.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use sm2_io::Latch;

/// Ends all waits of a program: a handle that any thread can use, also a signal handler.
///
/// After [`request`](Self::request), each of these ends at once, and so does each later one:
///
/// | wait | result |
/// | --- | --- |
/// | [`wait`] and `wait_timeout` of a set that [ends with](crate::WaitSet::end_with) it | [`WaitError::Shutdown`] |
/// | [`run`] of an executor that [ends with](crate::Executor::end_with) it | `Ok(())` |
/// | [`sleep_unless`](crate::Rate::sleep_unless) of a [`Rate`](crate::Rate) | `None` |
///
/// The same holds for a node that was [built](crate::NodeBuilder::shutdown) with it:
///
/// | wait | result |
/// | --- | --- |
/// | `recv`, `recv_timeout`, `recv_each` | [`RecvError::Shutdown`], even if messages are there |
/// | `call`, [`Call::wait`](crate::Call::wait) | [`CallError::Shutdown`], unless the reply is there |
/// | [`publish`] that waits for a subscriber | [`PublishError::Shutdown`]; those with room have the message |
/// | `wait_for_…`, `flush`, `next`, declarations, queries | the variant `Shutdown` of their error |
/// | [`Node::spin`](crate::Node::spin) and its variants | `Ok(())` |
///
/// [`wait`]: crate::WaitSet::wait
/// [`run`]: crate::Executor::run
/// [`publish`]: crate::Publisher::publish
/// [`WaitError::Shutdown`]: crate::WaitError::Shutdown
/// [`RecvError::Shutdown`]: crate::RecvError::Shutdown
/// [`CallError::Shutdown`]: crate::CallError::Shutdown
/// [`PublishError::Shutdown`]: crate::PublishError::Shutdown
///
/// The methods that never wait (`try_…`, `publish` with room) go on as before, so a program can take the messages that
/// are left and publish a last one. Futures (feature `tokio`) are cancelled by dropping them instead. There is no way
/// back: a new run needs a new handle.
///
/// # Signals
///
/// [`on_signals`](Self::on_signals) gives a handle whose shutdown Ctrl-C requests. A program with signal handlers of
/// its own calls [`request`](Self::request) in them, which is async-signal-safe: it stores a word, writes to an
/// eventfd, and leaves `errno` as it was. A handler must not drop the last clone.
///
#[cfg_attr(feature = "signals", doc = "```no_run")]
#[cfg_attr(not(feature = "signals"), doc = "```ignore")]
/// use sm2_node::{Node, Shutdown};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let shutdown = Shutdown::on_signals()?;
/// let node = Node::builder("listener").shutdown(&shutdown).connect()?;
/// let subscriber = node.subscriber::<str>("chatter")?;
/// while let Ok(sample) = subscriber.recv() {
///     println!("{}", &*sample);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Shutdown {
    latch: Arc<Latch>,
}

impl Shutdown {
    /// Creates a handle. Clones are handles of the same shutdown.
    ///
    /// # Errors
    ///
    /// Errors of `eventfd(2)`: too many descriptors, or no memory.
    pub fn new() -> io::Result<Self> {
        let latch = Arc::new(Latch::new()?);
        Ok(Self { latch })
    }

    /// Creates a handle whose shutdown is requested by Ctrl-C (SIGINT), SIGTERM and SIGHUP; not by SIGHUP if the
    /// process was started with that signal ignored, as `nohup(1)` does. A signal after the request ends the process at
    /// once, even if the program is stuck.
    ///
    /// A thread waits for the signals until the process ends. Each call makes a further handle with a thread of its
    /// own, so a program calls this once, and clones the handle.
    ///
    /// # Errors
    ///
    /// Errors of `sigaction(2)`, `socketpair(2)` and `pthread_create(3)`: too many descriptors, or no memory.
    #[cfg(feature = "signals")]
    pub fn on_signals() -> io::Result<Self> {
        let shutdown = Self::new()?;
        shutdown.request_on_signals()?;
        Ok(shutdown)
    }

    #[cfg(feature = "signals")]
    fn request_on_signals(&self) -> io::Result<()> {
        use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
        use signal_hook::iterator::Signals;

        let mut signals = Signals::new([SIGINT, SIGTERM])?;
        if !sm2_io::is_signal_ignored(SIGHUP) {
            signals.add_signal(SIGHUP)?;
        }
        let shutdown = self.clone();
        let wait = move || {
            for signal in signals.forever() {
                if shutdown.is_requested() {
                    // The process ends here. If that fails, nothing else can be done.
                    let _ = signal_hook::low_level::emulate_default_handler(signal);
                }
                shutdown.request();
            }
        };
        sm2_io::spawn_without_signals("sm2:signals".into(), wait).map(drop)
    }

    /// Ends all waits, now and later. Never blocks.
    pub fn request(&self) {
        self.latch.set();
    }

    /// Whether the shutdown was requested.
    #[must_use]
    #[inline]
    pub fn is_requested(&self) -> bool {
        self.latch.is_set()
    }
}

/// Readable once the shutdown was requested. It stays readable.
impl AsFd for Shutdown {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.latch.as_fd()
    }
}
