//! Huge pages for the memory of messages, where the kernel provides them.
//!
//! The kernel zeroes, maps and frees a page of 2 MiB as one, while 512 small pages cost a fault or a
//! look-up each on both sides. A new sealed message of some megabytes spends most of its time on
//! that. There are two ways to get huge pages:
//!
//! - The operator allows them for shared memory (`shmem_enabled`). After `MADV_HUGEPAGE` every fault
//!   provides a huge page.
//! - The setting is `never`, the default of most distributions. `MADV_COLLAPSE` (Linux 6.1) asks for
//!   the huge pages of one range at once. Only the setting `deny` forbids that as well.
//!
//! The second way has a price on machines with real-time threads: the kernel drains the page lists of
//! every processor, and waits for a processor that a real-time thread never leaves. Memory that is
//! preallocated before it is needed avoids the wait, and `deny` rules it out.
//!
//! Without huge pages the same code uses small ones: the difference is only time.
//!
//! New sealed memory from 512 KiB on, and large pooled slots at their first use, are collapsed. On a busy machine,
//! `cargo run --release -p sm2-io --example memory` printed these medians for 10 MiB: 0.73 ms from known bytes to a
//! sealed descriptor (4.2 ms with small pages), and 0.21 ms to map and read them (2.2 ms).

use std::sync::OnceLock;

use crate::sync::{AtomicU64, Ordering};
use crate::syscall::files;

/// The size of a huge page on the supported machines.
pub(crate) const HUGE_PAGE_BYTES: usize = 2 << 20;

/// From this length on, a sealed message gets a huge page of its own. It saves time on both sides
/// from 256 KiB on, and at this length it costs at most four times the memory while the message
/// exists.
pub(crate) const HUGE_LEAST_BYTES: usize = HUGE_PAGE_BYTES / 4;

/// Requests for huge pages that are skipped after one failed: the search for a huge page in
/// fragmented memory takes long.
const PAUSE: u64 = 256;

/// The requests that are still to be skipped.
static PAUSED: AtomicU64 = AtomicU64::new(0);

/// Whether large shared mappings get huge pages on request, by the setting in
/// `/sys/kernel/mm/transparent_hugepage/shmem_enabled` when first asked.
/// Where that is unknown, they do not.
pub fn huge_pages_allowed() -> bool {
    static ALLOWED: OnceLock<bool> = OnceLock::new();
    *ALLOWED.get_or_init(|| {
        files::read_text("/sys/kernel/mm/transparent_hugepage/shmem_enabled")
            .is_ok_and(|setting| huge_pages_allowed_by(&setting))
    })
}

/// Parses the kernel's notation for a choice: `always within_size [advise] never`.
#[doc(hidden)]
#[must_use]
pub fn huge_pages_allowed_by(setting: &str) -> bool {
    let allowed = ["[always]", "[within_size]", "[advise]", "[force]"];
    (setting.split_whitespace()).any(|word| allowed.contains(&word))
}

/// Whether to ask for huge pages this time.
pub(crate) fn may_ask() -> bool {
    // Relaxed, and not one atomic step: two threads that count at the same time may count once. No
    // other memory depends on this number.
    let paused = PAUSED.load(Ordering::Relaxed);
    PAUSED.store(paused.saturating_sub(1), Ordering::Relaxed);
    paused == 0
}

/// Records that the kernel had no huge page.
pub(crate) fn pause() {
    PAUSED.store(PAUSE, Ordering::Relaxed);
}
