//! Offenders that still exist. Lists here only shrink.

/// Root file of a crate, and how many of its files are in cycles at most.
pub(crate) const FILES_IN_CYCLES: &[(&str, usize)] = &[];

/// File, and how many of its lines, functions, or the file itself are too long at most.
pub(crate) const SIZES: &[(&str, usize)] = &[];

/// File, and how many of its runs of ten lines or more stand elsewhere, too, at most.
pub(crate) const REPETITIONS: &[(&str, usize)] = &[];

/// File, and how many of its lines break a rule of `limits.rs` at most.
pub(crate) const HASTY_TESTS: &[(&str, usize)] = &[
    ("sm2-gateway/tests/stuck_link.rs", 1),
    ("sm2-manager/tests/own_loop.rs", 1),
    ("sm2-node/tests/common/threads.rs", 1),
    ("sm2-node/tests/manager_change.rs", 1),
    ("sm2-node/tests/ring_calls.rs", 1),
    ("sm2-node/tests/ring_waits.rs", 1),
    ("sm2-node/tests/shutdown.rs", 3),
];

/// Folder of a package (`.` for files of none), and how many of its sentences break a rule of
/// `prose.rs` at most.
pub(crate) const SENTENCES: &[(&str, usize)] = &[];
