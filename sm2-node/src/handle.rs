//! What all four kinds of interface have in common.

pub(crate) mod declaration;
mod declare;
mod many;
pub(crate) mod methods;
pub(crate) mod receive;
mod store;

use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use sm2_proto::{Instant, InterfaceId, Name};

use crate::driver::{Bell, Inner, Interface, LinkStatus, Reserved, Shared, Tools, Topic};
use crate::{Wait, WaitError};

/// A declared interface, until it is dropped.
#[derive(Debug)]
pub(crate) struct Handle {
    pub(crate) shared: Arc<Shared>,
    pub(crate) id: InterfaceId,
    pub(crate) name: Name,
    matched: usize,
    pool_limit_bytes: u64,
    /// Payloads of up to this length travel in the datagram itself.
    pub(crate) inline_max: usize,
    /// What a thread does while it waits for a message of this interface.
    pub(crate) wait: Wait,
    /// Made when somebody asks for a descriptor; none if that failed.
    bell: OnceLock<Option<Bell>>,
    /// Tasks that wait for the descriptor, to be told when somebody else silences it: the
    /// runtime learns of changes alone, and this one is over before it asks.
    #[cfg(feature = "tokio")]
    pub(crate) silenced: Arc<tokio::sync::Notify>,
}

impl Handle {
    /// How long unused memory is kept, and what is there before any message.
    pub(crate) fn keep(&mut self, idle: Duration, reserved: Option<Reserved>) {
        let bytes = reserved.as_ref().map_or(0, Reserved::bytes);
        self.pool_limit_bytes = self.pool_limit_bytes.saturating_add(bytes);
        self.with_idle(|interface, _| {
            interface.outbox.keep_idle(idle);
            if let Some(reserved) = reserved {
                interface.outbox.adopt(reserved);
            }
        });
    }

    /// Whether the Manager that is there has it.
    pub(crate) fn is_registered(&self) -> bool {
        self.shared.driven().is_registered(self.id)
    }

    pub(crate) const fn matched(&self) -> usize {
        self.matched
    }

    /// Drives the node and changes the interface.
    pub(crate) fn with<R>(&self, change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R) -> R {
        (self.shared.with(self.id, change)).expect("the interface lives as long as its handle")
    }

    /// The same, but the node is driven only if it is time to, as long as all links have rings.
    pub(crate) fn with_due<R>(
        &self,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> R {
        (self.shared.with_due(self.id, change)).expect("the interface lives as long as its handle")
    }

    /// Changes the interface, without driving the node.
    pub(crate) fn with_idle<R>(
        &self,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> R {
        (self.shared.with_idle(self.id, change)).expect("the interface lives as long as its handle")
    }

    pub(crate) fn links(&self) -> Vec<LinkStatus> {
        self.with(|interface, _| interface.statuses())
    }

    /// Waits until `wanted` links are open.
    pub(crate) fn wait_open(
        &self,
        wanted: usize,
        timeout: Option<Duration>,
    ) -> Result<(), WaitError> {
        let mut found = 0;
        let topic = Topic::Interface(self.id);
        let waited = self.shared.wait(topic, until(timeout), |inner| {
            found = inner.interfaces.get(&self.id)?.open_links();
            (found >= wanted).then_some(())
        });
        if waited.map_err(WaitError::Io)?.is_some() {
            return Ok(());
        }
        let kind = self.with_idle(|interface, _| interface.contract.kind().counterpart());
        Err(match self.shared.lock().away() {
            Some(end) => WaitError::ManagerGone {
                kind,
                found,
                wanted,
                end,
            },
            None => WaitError::TimedOut {
                kind,
                found,
                wanted,
            },
        })
    }

    /// What `look` finds. If that is nothing, the descriptor, if there is one, is readable again when
    /// something comes; since something may have come meanwhile, it looks once more then.
    pub(crate) fn look<T>(
        &self,
        inner: &mut Inner,
        mut look: impl FnMut(&mut Inner) -> Option<T>,
    ) -> Option<T> {
        look(inner).or_else(|| match self.silence(inner) {
            true => look(inner),
            false => None,
        })
    }

    /// Whether to look once more.
    pub(crate) fn silence(&self, inner: &mut Inner) -> bool {
        let Some(Some(bell)) = self.bell.get() else {
            return false;
        };
        if bell.silence(inner) {
            #[cfg(feature = "tokio")]
            self.silenced.notify_waiters();
        }
        inner.park(Topic::Interface(self.id))
    }

    /// What a program can poll: see [`Bell`].
    pub(crate) fn descriptor(&self) -> BorrowedFd<'_> {
        let make = || match Bell::new(&self.shared, self.id) {
            Ok(bell) => Some(bell),
            Err(error) => {
                tracing::warn!(%error, name = %self.name, "no descriptor of its own: the node's is used");
                None
            }
        };
        match self.bell.get_or_init(make) {
            Some(bell) => bell.as_fd(),
            None => self.shared.epoll.as_fd(),
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        let mut inner = self.shared.driven();
        if let Some(Some(bell)) = self.bell.get() {
            bell.remove(&mut inner);
        }
        inner.withdraw(self.id, &self.shared.epoll);
    }
}

/// The moment `timeout` from now.
pub(crate) fn until(timeout: Option<Duration>) -> Option<Instant> {
    timeout.map(|timeout| sm2_io::clock::now().after(timeout))
}
