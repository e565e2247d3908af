//! The atomics of memory that is shared with other processes.
//!
//! What shares memory takes them from here and from nowhere else, so that
//! `verification/loom` can put the ones of loom in their place and run the same code
//! through executions that the memory model allows.

pub(crate) use std::sync::atomic::{AtomicU64, Ordering, fence};
