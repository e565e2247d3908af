//! Offenders that still exist. Lists here only shrink.

/// Root file of a crate, and how many of its files are in cycles at most.
pub(crate) const FILES_IN_CYCLES: &[(&str, usize)] = &[];

/// File, and how many of its lines, functions, or the file itself are too long at most.
pub(crate) const SIZES: &[(&str, usize)] = &[];

/// Folder of a package with the name of a structure, and how many `bool` fields it has at most.
pub(crate) const FLAGS: &[(&str, usize)] = &[("sm2-node/LinkStatus", 6), ("sm2-proto/Link", 4)];

/// Folder of a package with the name of a type, and how many files have its `impl` blocks at most.
pub(crate) const IMPL_FILES: &[(&str, usize)] = &[];

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

/// How many relative clauses begin with a preposition, as 'of which' does, at most.
pub(crate) const CHAINED_RELATIVES: usize = 20;

/// Folder of a package (`.` for files of none), and how many of its sentences break a rule of
/// `prose.rs` at most.
pub(crate) const SENTENCES: &[(&str, usize)] = &[];
