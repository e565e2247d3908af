//! The counters that tools can read: one file, with one entry for each interface and for each of
//! the node's ends of links (SPEC section 12).

use std::io;
use std::os::fd::OwnedFd;

use sm2_io::counters::Update;
use sm2_io::{CounterEntry, CounterPage};
use sm2_proto::{Instant, InterfaceId, LinkId};

use super::interface::Header;

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
                self.failed = true;
                tracing::warn!(%error, "no memory for counters: tools will not see what this node does");
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
        sm2_io::duplicate(page)
    }

    /// Allocates an entry. `None` if there is no file or the file is full; the interface or link is
    /// then not counted.
    pub(super) fn allocate(
        &mut self,
        interface: InterfaceId,
        link: Option<LinkId>,
    ) -> Option<CounterEntry> {
        let created = sm2_io::clock::now();
        self.page.as_mut()?.allocate(interface, link, created)
    }

    pub(super) fn free(&mut self, entry: CounterEntry) {
        if let Some(page) = &mut self.page {
            page.free(entry);
        }
    }
}

/// Counts a message of a topic that the application took at `now`, and makes a further change of the entry.
#[inline]
pub(super) fn count_taken(
    entry: Option<&mut CounterEntry>,
    now: Instant,
    header: &Header,
    change: impl FnOnce(&mut Update<'_>),
) {
    update(entry, |entry| {
        entry.taken(now, header.time, header.len);
        if header.lost > 0 {
            entry.lost(header.lost);
        }
        change(entry);
    });
}

/// Changes an entry, if the interface or link has one.
//= SM2-CNT-005
#[inline]
pub(super) fn update(entry: Option<&mut CounterEntry>, change: impl FnOnce(&mut Update<'_>)) {
    if let Some(entry) = entry {
        change(&mut entry.update());
    }
}
