//! The thread that drives the control side of a node while its program does other things.
//!
//! A publisher whose program sleeps must still be found by new subscribers: an emergency stop is sent only when it is
//! needed. The thread handles the session, links that open or end, and messages that wait for room. Calls of the
//! program handle all other packets, and these do not wake the thread: a link's socket is in the control set with an
//! interest that follows the link's state (`event_sets.rs`). Before it publishes, a call reads the sockets of links
//! that are opening, so a message that is published after a subscriber's `wait_for_publishers` has returned is offered
//! to its link.

use std::io;
use std::os::fd::AsFd;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use sm2_io::Waker;

use super::event_sets::NodeSets;
use super::limits::SHORTAGE_PAUSE;
use super::sleep::sleep;

/// The kernel keeps this many bytes of a thread's name.
const NAME_MAX: usize = 15;

/// The background thread of a node. Dropping this value ends the thread.
///
/// The thread sleeps until a descriptor of the control set has an event, locks the node, and does the work of all
/// pending events. It inherits the scheduling policy, the priority and the affinity of the thread that connected
/// the node. All signals are blocked in it.
#[derive(Debug)]
pub(super) struct BackgroundThread {
    /// `None` once the thread was told to end.
    thread: Option<JoinHandle<()>>,
    stop: Arc<Waker>,
}

impl BackgroundThread {
    /// Starts the thread of the node with this name. `drive` does the work of all pending events of the control set,
    /// and returns whether the kernel had no memory for it. From now on, calls of the program are not woken for the
    /// control side.
    ///
    /// # Errors
    ///
    /// Errors of `eventfd(2)`, `epoll_ctl(2)` and `pthread_create(3)`.
    pub(super) fn start(
        node: &str,
        sets: &Arc<NodeSets>,
        drive: impl FnMut() -> bool + Send + 'static,
    ) -> io::Result<Self> {
        let stop = Arc::new(Waker::new()?);
        sets.detach_control()?;
        let thread = sm2_io::spawn_without_signals(thread_name(node), {
            let (sets, stop) = (Arc::clone(sets), Arc::clone(&stop));
            move || run(&sets, &stop, drive)
        })?;
        Ok(Self {
            thread: Some(thread),
            stop,
        })
    }
}

impl Drop for BackgroundThread {
    fn drop(&mut self) {
        let Some(thread) = self.thread.take() else {
            return;
        };
        self.stop.wake();
        // A `tracing` subscriber that owns the last handle drops it on the thread itself.
        if thread.thread().id() != thread::current().id() {
            let _ = thread.join();
        }
    }
}

/// Drives the control side until the end of the node. If the kernel had no memory for an event, pauses before it tries
/// again.
//= SM2-TRN-013
fn run(sets: &NodeSets, stop: &Waker, mut drive: impl FnMut() -> bool) {
    loop {
        // Only a `tracing` subscriber can panic here: no other code of the program runs on this thread. The node
        // stays usable, and the next event continues the work.
        let short_of_memory = catch_unwind(AssertUnwindSafe(&mut drive)).unwrap_or(true);
        if sleep(
            &[sets.control.as_fd()],
            Some(stop),
            None,
            short_of_memory,
            None,
        )
        .is_err()
        {
            thread::sleep(SHORTAGE_PAUSE);
        }
        if stop.drain() {
            return;
        }
    }
}

/// `sm2:` and the beginning of the node's name, which is ASCII.
fn thread_name(node: &str) -> String {
    let mut name = format!("sm2:{node}");
    name.truncate(NAME_MAX);
    name
}
