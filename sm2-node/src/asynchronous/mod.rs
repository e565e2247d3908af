//! Nodes in tokio programs (feature `tokio`).
//!
//! The same handles, whose waiting calls are futures. Nothing here blocks a thread of the
//! runtime, but for the short moments in which the node's sockets are read and written; every
//! future is cancellation-safe: one that is dropped before it is ready has taken nothing
//! (a [`call`](AsyncClient::call) that is dropped is cancelled; a
//! [`publish`](AsyncPublisher::publish) that is dropped has reached all but the
//! reliable subscribers that it still waited for).
//!
//! ```no_run
//! use futures_util::StreamExt;
//! use sm2_node::{Node, asynchronous::IntoAsync};
//!
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let node = Node::new("planner")?;
//! let mut scans = node.subscriber::<[f32]>("scan")?.into_async()?;
//! let driver = tokio::spawn(sm2_node::asynchronous::drive(node));
//! while let Some(scan) = scans.next().await {
//!     println!("{} ranges", scan?.len());
//! }
//! # driver.abort();
//! # Ok(())
//! # }
//! ```
//!
//! Connecting and declaring wait for the Manager's word, which takes well under a millisecond
//! where one runs, and up to the node's time-out where it is stuck. A program that cannot have
//! this on a thread of its runtime does both in `tokio::task::spawn_blocking`.
//!
//! A node has no thread of its own here either: handles move it on when they are polled.
//! [`drive`] is for a program in which none may be polled for a while.

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

/// Handles that can be used in futures.
pub trait IntoAsync: Sized {
    /// What it becomes.
    type Async;

    /// The same handle for futures.
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

/// Moves a node on, whenever there is something to do, for as long as it is polled: spawn it.
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

/// Something with a descriptor that the runtime watches.
///
/// The runtime learns of changes alone (edges), and a look may leave something behind: a node
/// reads each socket a bounded number of times. So whoever found nothing asks the
/// descriptor itself before it waits.
#[derive(Debug)]
struct Watched<S: AsFd> {
    /// Before the source: it is a duplicate of its descriptor.
    fd: AsyncFd<OwnedFd>,
    source: S,
    /// Whoever takes note of a change tells all others who wait for the same descriptor.
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
            // From here on no change is missed, whoever takes note of it.
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

    /// The same for the only task that uses it.
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
