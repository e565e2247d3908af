//! Searches a bag for the first message from a time on, in a fresh process and without the page cache.

use std::{collections::BTreeSet, fs::File, io, path::Path};

use nix::fcntl::{PosixFadviseAdvice, posix_fadvise};
use sm2_bag::{Bag, Filter};

use super::Failure;
use crate::{
    clock::now_ns,
    job::{Outcome, Seek, Sought},
    measure,
    payload::check,
};

/// Opens the bag, and reads the first message of the topic.
pub(super) fn seek(seek: &Seek) -> Result<Outcome, Failure> {
    drop_cache(&seek.file)?;
    let fetched_before = measure::fetched_bytes()?;
    let start_ns = now_ns();
    let bag = Bag::open(&seek.file)?;
    let opened_ns = now_ns();
    let filter = Filter {
        from_ns: Some(seek.at_ns),
        topics: BTreeSet::from_iter(seek.topic.clone()),
        ..Filter::default()
    };
    let first = bag.messages(&filter).next();
    let done_ns = now_ns();
    let first = first.ok_or("the bag has no message from this time on")??;
    if first.log_time < seek.at_ns || check(&first.data).is_err() {
        return Err("the first message is not the one that was asked for".into());
    }
    Ok(Outcome::Sought(Sought {
        open_ns: opened_ns - start_ns,
        first_ns: done_ns - start_ns,
        peak_bytes: measure::peak_bytes()?,
        fetched_bytes: measure::fetched_bytes()? - fetched_before,
    }))
}

/// Removes the pages of a file from the page cache. The file is on the disk already.
fn drop_cache(path: &Path) -> io::Result<()> {
    let file = File::open(path)?;
    posix_fadvise(&file, 0, 0, PosixFadviseAdvice::POSIX_FADV_DONTNEED)?;
    Ok(())
}
