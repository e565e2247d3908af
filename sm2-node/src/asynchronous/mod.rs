//! Nodes in tokio programs (feature `tokio`).
//!
//! The same handles, with futures in place of waiting calls. No future blocks a thread of the runtime, except
//! while the node's sockets are read and written. Every future is cancellation-safe: a future that is dropped
//! before it is ready has taken no message. Dropping a pending [`call`](AsyncClient::call) cancels the call.
//! Dropping a pending [`publish`](AsyncPublisher::publish) skips only the reliable subscribers that had no
//! room yet.
//!
//! ```no_run
//! use futures_util::StreamExt;
//! use sm2_node::{Node, asynchronous::IntoAsync};
//!
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let node = Node::new("planner")?;
//! let mut scans = node.subscriber::<[f32]>("scan")?.into_async()?;
//! while let Some(scan) = scans.next().await {
//!     println!("{} ranges", scan?.len());
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Connecting and declaring wait for the Manager's answer: usually well under a millisecond, but up to the
//! node's timeout if the Manager is stuck. A program that cannot block a thread of its runtime for so long
//! calls both in `tokio::task::spawn_blocking`.
//!
//! The node's background thread does the work of the control side here, too. [`drive`] is for a node without that
//! thread ([`NodeBuilder::background`](crate::NodeBuilder::background)) whose program may poll no handle for a while.

mod client;
mod publisher;
mod server;
mod subscriber;

use std::convert::Infallible;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use futures_util::future::{Either, select};
use tokio::io::unix::AsyncFd;
use tokio::sync::Notify;

pub use self::subscriber::AsyncSubscriber;
pub use self::{client::AsyncClient, publisher::AsyncPublisher, server::AsyncServer};
use crate::Node;

/// Converts a handle into one that works with futures.
pub trait IntoAsync: Sized {
    /// The handle for futures.
    type Async;

    /// Converts the handle.
    ///
    /// # Errors
    ///
    /// Any error of `epoll_ctl(2)`, such as too many descriptors or no memory.
    ///
    /// # Panics
    ///
    /// Outside of a tokio runtime with I/O enabled.
    fn into_async(self) -> io::Result<Self::Async>;
}

/// Drives a node without a background thread for as long as the future is polled: spawn it as a task.
///
/// # Errors
///
/// As [`Node::spin`].
///
/// # Panics
///
/// Outside of a tokio runtime with I/O enabled.
pub async fn drive(node: Node) -> io::Result<Infallible> {
    let node = Watched::new(node, Arc::default())?;
    let error = node.wait(|node| node.spin_some().err()).await?;
    Err(error)
}

/// A handle whose descriptor the runtime watches.
///
/// The runtime reports only changes (edges), and one look may leave data in a socket, because a node reads
/// each socket a bounded number of times. A task that found nothing therefore checks the descriptor itself
/// before it waits.
#[derive(Debug)]
struct Watched<S: AsFd> {
    /// Declared before the source, whose descriptor it duplicates, so that it is dropped first.
    fd: AsyncFd<OwnedFd>,
    source: S,
    /// A task that consumes a readiness event notifies all other tasks that wait for the same descriptor.
    changed: Arc<Notify>,
}

impl<S: AsFd> Watched<S> {
    fn new(source: S, changed: Arc<Notify>) -> io::Result<Self> {
        Ok(Self {
            fd: sm2_io::watch_readable(source.as_fd())?,
            source,
            changed,
        })
    }

    fn get(&self) -> &S {
        &self.source
    }

    fn into_inner(self) -> S {
        self.source
    }

    /// Waits until `look` finds something. Any number of tasks may wait.
    async fn wait<T>(&self, mut look: impl FnMut(&S) -> Option<T>) -> io::Result<T> {
        loop {
            let mut changed = pin!(self.changed.notified());
            // From here on no change is missed, whichever task consumes it.
            changed.as_mut().enable();
            if let Some(found) = look(self.get()) {
                return Ok(found);
            }
            if self.is_ready()? {
                tokio::task::yield_now().await;
                continue;
            }
            match select(pin!(self.fd.readable()), changed).await {
                Either::Left((ready, _)) => {
                    ready?.clear_ready();
                    self.changed.notify_waiters();
                }
                Either::Right(((), _)) => {}
            }
        }
    }

    /// As [`wait`](Self::wait), for a handle that only one task uses.
    fn poll<T>(
        &self,
        context: &mut Context<'_>,
        mut look: impl FnMut(&S) -> Option<T>,
    ) -> Poll<io::Result<T>> {
        loop {
            if let Some(found) = look(self.get()) {
                return Poll::Ready(Ok(found));
            }
            if self.is_ready()? {
                context.waker().wake_by_ref();
                return Poll::Pending;
            }
            ready!(self.fd.poll_read_ready(context))?.clear_ready();
        }
    }

    fn is_ready(&self) -> io::Result<bool> {
        sm2_io::wait_readable(&[self.get().as_fd()], Some(Duration::ZERO))
    }
}
