//! Huge pages for the memory of messages, where the kernel gives them.
//!
//! A page of 2 MiB is zeroed, mapped, and given back as one, while its 512 small pages cost a fault
//! or a look-up each, and that on both sides: they are what a new sealed message of
//! some megabytes spends its time on. There are two ways to get them:
//!
//! - The operator allows them for shared memory (`shmem_enabled`): `MADV_HUGEPAGE`, and every
//!   fault brings a whole one.
//! - The operator says nothing (`never`, the default of most distributions): `MADV_COLLAPSE`
//!   (Linux 6.1) asks for one range, now. Only `deny` forbids that as well.
//!
//! The second way has a price on machines with real-time threads: the kernel waits until every
//! processor has put away the pages that it was about to list, and one that a thread never
//! leaves does not get to it. Memory that is made ready before it matters does not depend on that,
//! and `deny` rules it out.
//!
//! Whoever gets none goes on with small ones: nothing depends on them but time.

use std::sync::OnceLock;

use crate::sync::{AtomicU64, Ordering};

/// What the kernel can map with a single page-table entry on the machines that
/// matter here.
pub(crate) const HUGE_PAGE_BYTES: usize = 2 << 20;

/// From this length on, a sealed message is worth a huge page of its own: it costs less time on
/// both sides from 256 KiB on, and at this length no more than four times the memory, as long as
/// the message lives.
pub(crate) const HUGE_LEAST_BYTES: usize = HUGE_PAGE_BYTES / 4;

/// How many times huge pages are not asked for after the kernel had none. Looking for one in
/// fragmented memory takes long.
const PAUSE: u64 = 256;

/// How many times are left.
static PAUSED: AtomicU64 = AtomicU64::new(0);

/// Whether large shared mappings get huge pages on request, by the setting in
/// `/sys/kernel/mm/transparent_hugepage/shmem_enabled` when first asked.
/// Where that is unknown, they do not.
pub fn huge_pages_allowed() -> bool {
    static ALLOWED: OnceLock<bool> = OnceLock::new();
    *ALLOWED.get_or_init(|| {
        std::fs::read_to_string("/sys/kernel/mm/transparent_hugepage/shmem_enabled")
            .is_ok_and(|setting| huge_pages_allowed_by(&setting))
    })
}

/// Reads the kernel's way of writing a choice: `always within_size [advise] never`.
#[doc(hidden)]
#[must_use]
pub fn huge_pages_allowed_by(setting: &str) -> bool {
    let chosen = |word: &&str| word.starts_with('[') && word.ends_with(']');
    let allowed = ["[always]", "[within_size]", "[advise]", "[force]"];
    (setting.split_whitespace().find(chosen)).is_some_and(|word| allowed.contains(&word))
}

/// Whether it is time to ask for huge pages.
pub(crate) fn may_ask() -> bool {
    // Two threads that count at the same time may count once: that does no harm, and nothing
    // else depends on this number.
    let paused = PAUSED.load(Ordering::Relaxed);
    PAUSED.store(paused.saturating_sub(1), Ordering::Relaxed);
    paused == 0
}

/// The kernel had none.
pub(crate) fn pause() {
    PAUSED.store(PAUSE, Ordering::Relaxed);
}
