//! Offenders that still exist. Lists here only shrink.

/// Root file of a crate, and how many of its files are in cycles at most.
pub(crate) const FILES_IN_CYCLES: &[(&str, usize)] = &[];

/// File, and how many of its lines, functions, or the file itself are too long at most.
pub(crate) const SIZES: &[(&str, usize)] = &[
    ("sm2-node/tests/schema.rs", 1),
    ("sm2-proto/src/link/calls/proofs.rs", 2),
    ("sm2-proto/src/link/inbound/proofs.rs", 1),
    ("sm2-proto/src/link/proofs.rs", 1),
    ("sm2-proto/src/link/ring/proofs.rs", 1),
    ("sm2-proto/tests/link_sender.rs", 1),
    ("sm2-proto/tests/link_violations.rs", 2),
    ("sm2-proto/tests/ring_calls_pair.rs", 1),
    ("sm2-proto/tests/ring_support/calls.rs", 1),
];

/// File, and how many of its runs of ten lines or more stand elsewhere, too, at most.
pub(crate) const REPETITIONS: &[(&str, usize)] = &[("sm2-proto/src/node/event.rs", 3)];

/// Folder of a package (`.` for files of none), and how many of its sentences break a rule of
/// `prose.rs` at most.
pub(crate) const SENTENCES: &[(&str, usize)] = &[];
