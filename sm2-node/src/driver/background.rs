//! The thread that drives the control side of a node while its program does other things.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use sm2_io::Waker;

use super::shared_node::NodeState;

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
    /// Starts the thread. From now on, calls of the program are not woken for the control side.
    ///
    /// # Errors
    ///
    /// Errors of `eventfd(2)`, `epoll_ctl(2)` and `pthread_create(3)`.
    pub(super) fn start(state: &Arc<NodeState>) -> io::Result<Self> {
        let stop = Arc::new(Waker::new()?);
        state.sets.detach_control()?;
        let thread = sm2_io::spawn_without_signals(thread_name(state.name.as_str()), {
            let (state, stop) = (Arc::clone(state), Arc::clone(&stop));
            move || run(&state, &stop)
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

/// Drives the control side until the end of the node.
fn run(state: &NodeState, stop: &Waker) {
    loop {
        // Only a `tracing` subscriber can panic here: no other code of the program runs on this thread. The node
        // stays usable, and the next event continues the work.
        let driven = catch_unwind(AssertUnwindSafe(|| state.drive_control()));
        state.sleep_for_control(stop, driven.unwrap_or(true));
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
