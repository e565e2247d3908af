//! Calling closures for messages, requests, replies, events and ticks.

mod callback;
mod group;
mod id;
mod mailbox;
mod origin;
pub(crate) mod runs;
mod task;
mod tasks;
mod turn;

use std::io;
use std::panic;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

pub(crate) use self::callback::WithCauses;
pub use self::callback::{ExecutorError, Failure};
pub use self::group::Group;
pub use self::id::CallbackId;
use self::mailbox::Mailbox;
pub use self::origin::{CallbackSource, Origin};
use self::runs::{Duties, GroupKey, Run};
use self::tasks::{Addition, End, SharedTask, Tasks};
use crate::{Node, Shutdown};

/// The name of the threads of an executor.
const THREAD: &str = "sm2-executor";

/// Calls closures for the messages, requests, replies, events and ticks of a program: a [`WaitSet`](crate::WaitSet)
/// with a callback for each source.
///
/// Callbacks belong to [groups](Group). The callbacks of a group exclude each other and share a state, which each of
/// them gets as `&mut`. [`run`](Self::run) calls all of them in one thread, and [`run_threads`](Self::run_threads) in
/// several: then callbacks of different groups run at the same time.
///
/// ```no_run
/// use sm2_node::{Executor, Node, Shutdown, Timer};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let shutdown = Shutdown::new()?;
/// let node = Node::new("driver")?;
/// let speed = node.publisher::<f32>("speed")?;
///
/// let mut executor = Executor::new()?;
/// executor.end_with(&shutdown)?;
/// let control = executor.group(f32::INFINITY);
/// control.on_message(node.subscriber::<[f32]>("scan")?, |nearest, scan| {
///     *nearest = scan?.iter().copied().fold(f32::INFINITY, f32::min);
///     Ok(())
/// });
/// control.on_tick(Timer::hz(100), |nearest, _| {
///     speed.publish(&nearest.min(1.0))?;
///     Ok(())
/// });
/// executor.run()?;
/// # Ok(())
/// # }
/// ```
///
/// # Callbacks
///
/// - A callback that returns an error ends the executor: `run` returns the error and the callback's [`Origin`], after
///   the callbacks that run in other threads have come to their end.
/// - A callback that panics ends the executor in the same way, and the panic goes on in the thread that called `run`.
///   The state of the group is as the panic left it.
/// - A callback can add and remove callbacks, also itself, with a clone of a group. The change is made before the
///   executor waits the next time. If a source cannot be added (too many descriptors, no memory), `run` returns the
///   error.
/// - A callback that waits holds up its group, and with [`run`](Self::run) all groups. It cannot wait for the reply of
///   a server of these groups: the call fails with [`CallError::OwnExecutor`](crate::CallError::OwnExecutor). Two
///   callbacks of an executor with several threads that wait for each other's service are not noticed.
/// - The callbacks of a group that are due at the same time run in turn. No group comes before another one.
///
/// # Cost
///
/// An executor waits with one `epoll` call for all sources, as a wait set does, and allocates nothing for a callback.
/// With several threads, one of them waits. It takes the message, lets another thread wait, and runs the callback.
/// While a callback of a group runs, the other ready sources of this group are set aside, so the thread that waits does
/// not see them again and again. At the end of the callback, one write wakes that thread for them. A descriptor that is
/// set aside costs two calls more.
#[derive(Debug)]
pub struct Executor<'a> {
    /// Locked by the thread that waits.
    tasks: Mutex<Tasks<'a>>,
    mailbox: Arc<Mailbox<Addition<'a>>>,
    duties: Arc<Duties>,
}

impl<'a> Executor<'a> {
    /// Creates an executor without callbacks.
    ///
    /// # Errors
    ///
    /// Errors of `epoll_create1(2)`, `eventfd(2)` and `epoll_ctl(2)`: too many descriptors, or no memory.
    pub fn new() -> io::Result<Self> {
        let mailbox = Arc::new(Mailbox::new()?);
        let duties = Arc::default();
        Ok(Self {
            tasks: Mutex::new(Tasks::new(&mailbox, &duties)?),
            mailbox,
            duties,
        })
    }

    /// Creates a group of callbacks that share `state`.
    pub fn group<S: Send + 'a>(&self, state: S) -> Group<'a, S> {
        Group::new(state, &self.mailbox, &self.duties)
    }

    /// Ends the executor when this shutdown is requested.
    ///
    /// # Errors
    ///
    /// As [`WaitSet::end_with`](crate::WaitSet::end_with).
    pub fn end_with(&mut self, shutdown: &Shutdown) -> io::Result<()> {
        self.lock().set.end_with(shutdown)
    }

    /// Drives a node without a background thread and without a source in the executor: see
    /// [`WaitSet::drive`](crate::WaitSet::drive).
    ///
    /// # Errors
    ///
    /// As [`WaitSet::drive`](crate::WaitSet::drive).
    pub fn drive(&mut self, node: &Node) -> io::Result<()> {
        self.lock().set.drive(node)
    }

    /// Runs the callbacks in this thread, until a shutdown.
    ///
    /// # Errors
    ///
    /// See [`ExecutorError`].
    ///
    /// # Panics
    ///
    /// If a callback panics.
    pub fn run(&mut self) -> Result<(), ExecutorError> {
        self.run_threads(1)
    }

    /// Runs the callbacks in this thread and in `threads - 1` new ones, until a shutdown. The new threads are called
    /// `sm2-executor`, and inherit the signal mask, the priority and the affinity of this thread.
    ///
    /// # Errors
    ///
    /// See [`ExecutorError`].
    ///
    /// # Panics
    ///
    /// If a callback panics.
    pub fn run_threads(&mut self, threads: usize) -> Result<(), ExecutorError> {
        self.mailbox.begin();
        self.duties.set_threads(threads);
        let this = &*self;
        thread::scope(|scope| {
            let end = EndAll(&this.mailbox);
            let mut others = Vec::new();
            for _ in 1..threads {
                let builder = thread::Builder::new().name(THREAD.to_owned());
                let thread = builder.spawn_scoped(scope, || this.work());
                others.push(thread.map_err(ExecutorError::Io)?);
            }
            let mut result = this.work();
            drop(end);
            for other in others {
                let other = other.join();
                result = result.and(other.unwrap_or_else(|panic| panic::resume_unwind(panic)));
            }
            result
        })
    }

    /// Runs callbacks until the end. Then ends the other threads, too.
    fn work(&self) -> Result<(), ExecutorError> {
        let _end = EndAll(&self.mailbox);
        loop {
            let next = self.lock().next();
            match next {
                Ok(Some(task)) => {
                    let running = Running {
                        mailbox: &self.mailbox,
                        _run: Run::begin(GroupKey::of(task.turn()), &self.duties),
                        task,
                    };
                    let origin = running.task.origin();
                    (running.task.run()).map_err(|error| ExecutorError::Callback {
                        origin: origin.clone(),
                        error,
                    })?;
                }
                Ok(None) | Err(End::Shutdown) => return Ok(()),
                Err(End::Error(error)) => return Err(error),
            }
        }
    }

    /// A panic under the lock can only be that of a destructor of the program's.
    fn lock(&self) -> MutexGuard<'_, Tasks<'a>> {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Executor<'_> {
    fn drop(&mut self) {
        self.mailbox.close();
    }
}

/// Ends all threads when it is dropped, also by a panic.
struct EndAll<'m, 'a>(&'m Mailbox<Addition<'a>>);

impl Drop for EndAll<'_, '_> {
    fn drop(&mut self) {
        self.0.leave(|letters| letters.is_over = true);
    }
}

/// A callback that runs. Gives the turn of its group back when it is dropped, also by a panic.
struct Running<'m, 'a> {
    task: SharedTask<'a>,
    mailbox: &'m Mailbox<Addition<'a>>,
    _run: Run,
}

impl Drop for Running<'_, '_> {
    fn drop(&mut self) {
        let waiting = self.task.turn().give_back();
        // The thread that waits need not wake for a group without another source that is ready.
        if !waiting.is_empty() {
            self.mailbox
                .leave(|letters| letters.resumed.extend(waiting));
        }
    }
}
