//! What a node counts for tools to look at: one file, one entry for each interface and
//! for each of its ends of links (SPEC section 12).

use std::io;
use std::os::fd::{AsFd, OwnedFd};

use sm2_io::counters::Update;
use sm2_io::{CounterEntry, CounterPage};
use sm2_proto::link::Role;
use sm2_proto::{Instant, InterfaceId, LinkId};

use super::link::LinkDriver;

/// The node's file. Without one, everything else goes on.
#[derive(Debug, Default)]
pub(crate) struct Counting {
    page: Option<CounterPage>,
    failed: bool,
}

impl Counting {
    /// Makes the file, unless it is there; whether it is new.
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

    /// The descriptor for the Manager, which hands it on to tools.
    pub(super) fn descriptor(&self) -> io::Result<OwnedFd> {
        let page = self.page.as_ref().ok_or(io::ErrorKind::NotFound)?;
        page.as_fd().try_clone_to_owned()
    }

    /// None if there is no file, or if it is full: then this one is not counted.
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
    /// A message went out.
    pub(super) fn note_sent(&mut self, time: Instant, len: u64, counting: &mut Counting) {
        let at = match self.role() {
            // Where a server stands, requests count.
            Role::Server => return self.note_fates(counting),
            // A request says when it is too late, not when it was made.
            Role::Caller => sm2_io::clock::now(),
            Role::Sender | Role::Receiver => time,
        };
        self.noted = self.counters();
        if let Some(mut entry) = counting.update(self.entry.as_ref()) {
            entry.published(at, len);
            entry.fates(&self.noted);
        }
    }

    /// What became of messages is noted, if anything did.
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
