//! Offenders that still exist. Lists here only shrink.

/// Root file of a crate, and how many of its files are in cycles at most.
pub(crate) const FILES_IN_CYCLES: &[(&str, usize)] = &[];

/// File, and how many of its lines, functions, or the file itself are too long at most.
pub(crate) const SIZES: &[(&str, usize)] = &[];

/// File, and how many of its runs of ten lines or more stand elsewhere, too, at most.
pub(crate) const REPETITIONS: &[(&str, usize)] = &[];

/// Folder of a package (`.` for files of none), and how many of its sentences break a rule of
/// `prose.rs` at most.
pub(crate) const SENTENCES: &[(&str, usize)] = &[];
