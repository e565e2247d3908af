//! The counters that tools can read: one file, with one entry for each interface and for each of
//! the node's ends of links (SPEC section 12).

use std::io;
use std::os::fd::{AsFd, OwnedFd};

use sm2_io::counters::Update;
use sm2_io::{CounterEntry, CounterPage};
use sm2_proto::link::Role;
use sm2_proto::{Instant, InterfaceId, LinkId};

use super::link::LinkDriver;

/// The file of the node's counters. If there is none, the node works without counters.
#[derive(Debug, Default)]
pub(crate) struct Counting {
    page: Option<CounterPage>,
    failed: bool,
}

impl Counting {
    /// Creates the file unless it exists. Returns whether it was created now.
    pub(super) fn start(&mut self) -> bool {
        if self.page.is_some() || self.failed {
            return false;
        }
        match CounterPage::new() {
            Ok(page) => self.page = Some(page),
            Err(error) => {
                tracing::warn!(%error, "no memory for counters: tools will not see what this node does");
                self.failed = true;
            }
        }
        self.page.is_some()
    }

    pub(super) const fn is_there(&self) -> bool {
        self.page.is_some()
    }

    /// The descriptor for the Manager, which passes it to tools.
    pub(super) fn descriptor(&self) -> io::Result<OwnedFd> {
        let page = self.page.as_ref().ok_or(io::ErrorKind::NotFound)?;
        page.as_fd().try_clone_to_owned()
    }

    /// Allocates an entry. `None` if there is no file or the file is full; the interface or link is
    /// then not counted.
    pub(super) fn allocate(
        &mut self,
        interface: InterfaceId,
        link: Option<LinkId>,
    ) -> Option<CounterEntry> {
        self.page.as_mut()?.allocate(interface, link)
    }

    pub(super) fn free(&mut self, entry: Option<CounterEntry>) {
        if let (Some(page), Some(entry)) = (&mut self.page, entry) {
            page.free(entry);
        }
    }

    /// Begins to change an entry; the change is complete when the result is dropped.
    //= SM2-CNT-004
    pub(super) fn update<'a>(&'a mut self, entry: Option<&'a CounterEntry>) -> Option<Update<'a>> {
        Some(self.page.as_mut()?.update(entry?))
    }

    /// Changes an entry.
    pub(super) fn note(
        &mut self,
        entry: Option<&CounterEntry>,
        change: impl FnOnce(&mut Update<'_>),
    ) {
        if let Some(mut update) = self.update(entry) {
            change(&mut update);
        }
    }
}

impl LinkDriver {
    /// Counts a message that was sent.
    pub(super) fn note_sent(&mut self, time: Instant, len: u64, counting: &mut Counting) {
        let at = match self.role() {
            // A server's entry counts requests, not replies.
            Role::Server => return self.note_fates(counting),
            // A request carries its deadline, not the time at which it was sent.
            Role::Caller => sm2_io::clock::now(),
            Role::Sender | Role::Receiver => time,
        };
        self.noted = self.counters();
        if let Some(mut entry) = counting.update(self.entry.as_ref()) {
            entry.published(at, len);
            entry.fates(&self.noted);
        }
    }

    /// Writes the outcomes of messages to the entry, if they have changed.
    pub(super) fn note_fates(&mut self, counting: &mut Counting) {
        let counters = self.counters();
        if counters != self.noted {
            self.noted = counters;
            if let Some(mut entry) = counting.update(self.entry.as_ref()) {
                entry.fates(&counters);
            }
        }
    }
}
