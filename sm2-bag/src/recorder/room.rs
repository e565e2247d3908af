//! Recordings that wait for room on the disk.

use super::Recorder;

impl Recorder<'_> {
    /// Lets a full disk cost messages, which become gaps, instead of ending the recording.
    pub(crate) const fn wait_for_room(&mut self) {
        self.waits_for_room = true;
    }

    /// Whether messages are dropped now because the disk is full.
    pub(super) fn lacks_room(&self) -> bool {
        self.waits_for_room && self.queue.is_disk_full()
    }
}
