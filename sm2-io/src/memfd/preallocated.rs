//! Memory for a sealed message, allocated before the message exists.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, OwnedFd};

use sm2_proto::Seals;

use super::file::{add_seals, allocate, create};
use super::loan::{Pages, SealedLoan};
use crate::huge::huge_pages_allowed;
use crate::mapping::writable::MappingMut;
use crate::syscall::files;

/// A new memfd with all its pages, for one message of up to
/// [`capacity_bytes`](Self::capacity_bytes).
///
/// Most of the time for a sealed message goes into getting and zeroing its pages, in particular
/// without huge pages. With preallocated memory one copy is left, or none for a [loan](Self::lend).
#[derive(Debug)]
pub struct Preallocated(Form);

#[derive(Debug)]
enum Form {
    /// Without a mapping: `pwrite(2)` is the fastest way to fill small pages.
    File {
        file: File,
        capacity: usize,
    },
    Mapped(SealedLoan),
}

impl Preallocated {
    /// Allocates memory for a message that will be [copied](Self::fill) into it.
    ///
    /// # Errors
    ///
    /// Any error of `memfd_create(2)`, `ftruncate(2)`, `fallocate(2)` and `mmap(2)`, such as too
    /// many descriptors, no memory, or a length that no file can have.
    pub fn for_copies(capacity_bytes: usize) -> io::Result<Self> {
        if let Some(loan) = SealedLoan::of_huge_pages(capacity_bytes)? {
            return Ok(Self(Form::Mapped(loan)));
        }
        let file = create(c"sm2-message", capacity_bytes as u64)?;
        allocate(&file, capacity_bytes)?;
        Ok(Self(Form::File {
            file,
            capacity: capacity_bytes,
        }))
    }

    /// Allocates memory for a message that will be [written in place](Self::lend).
    ///
    /// # Errors
    ///
    /// As [`for_copies`](Self::for_copies).
    pub fn for_loans(capacity_bytes: usize) -> io::Result<Self> {
        let loan = match SealedLoan::of_huge_pages(capacity_bytes)? {
            Some(loan) => loan,
            None => {
                let file = create(c"sm2-message", capacity_bytes as u64)?;
                allocate(&file, capacity_bytes)?;
                map(file, capacity_bytes)?
            }
        };
        Ok(Self(Form::Mapped(loan)))
    }

    /// The length of the longest message that fits.
    #[must_use]
    pub const fn capacity_bytes(&self) -> usize {
        match &self.0 {
            Form::File { capacity, .. } => *capacity,
            Form::Mapped(loan) => loan.len(),
        }
    }

    /// Seals a copy of `bytes`. The file may be longer; its rest is zero.
    ///
    /// # Errors
    ///
    /// Any error of `ftruncate(2)` and `pwrite(2)`; also as for [`SealedLoan::seal`].
    ///
    /// # Panics
    ///
    /// If `bytes` is longer than the capacity.
    pub fn fill(self, bytes: &[u8]) -> io::Result<OwnedFd> {
        self.check(bytes.len());
        match self.0 {
            Form::File { file, capacity } => {
                if bytes.len() < capacity {
                    files::set_len(&file, bytes.len() as u64)?;
                }
                files::write_all_at(&file, bytes, 0)?;
                add_seals(&file, Seals::SEALED)?;
                Ok(file.into())
            }
            Form::Mapped(loan) => loan.shortened(bytes.len()).filled(bytes),
        }
    }

    /// Makes a loan of `len` zeroes.
    ///
    /// # Errors
    ///
    /// Any error of `mmap(2)`, if the memory was allocated for copies.
    ///
    /// # Panics
    ///
    /// If `len` is greater than the capacity.
    pub fn lend(self, len: usize) -> io::Result<SealedLoan> {
        self.check(len);
        let loan = match self.0 {
            Form::File { file, capacity } => map(file, capacity)?,
            Form::Mapped(loan) => loan,
        };
        Ok(loan.shortened(len))
    }

    fn check(&self, len: usize) {
        let capacity = self.capacity_bytes();
        assert!(
            len <= capacity,
            "{len} bytes in a preallocated file of {capacity}"
        );
    }
}

fn map(file: File, len: usize) -> io::Result<SealedLoan> {
    let mapping = MappingMut::new(file.as_fd(), len as u64, huge_pages_allowed())?;
    match mapping.populate() {
        // An older kernel: the pages exist, and page faults map them one by one.
        Err(error) if error.kind() == io::ErrorKind::Unsupported => {}
        result => result?,
    }
    SealedLoan::of(file, mapping, len, Pages::Small)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt;

    use super::*;
    use crate::fault::{Call, Fault, Injector};
    use nix::libc;

    /// A kernel without memory refuses the allocation, and not the message that is written later.
    #[test]
    fn all_pages_exist_before_the_message() {
        for capacity in [1, 4_096, 100_000] {
            let preallocated = Preallocated::for_copies(capacity).unwrap();
            // Too short for huge pages, which are mapped.
            let Form::File { file, .. } = &preallocated.0 else {
                panic!("{preallocated:?}");
            };
            let allocated_bytes = 512 * file.metadata().unwrap().blocks();
            assert!(allocated_bytes >= capacity as u64, "{preallocated:?}");
        }
    }

    /// A signal interrupts a write, which goes on then. Any other error ends it.
    #[test]
    fn a_write_outlasts_a_signal_and_nothing_else() {
        for (errno, times) in [(libc::EINTR, 3), (libc::ENOMEM, 1), (libc::ENOSPC, 1)] {
            let preallocated = Preallocated::for_copies(5_000).unwrap();
            let faults = Injector::counting();
            let _installed = faults.install();
            faults.set([Fault {
                call: Call::Write,
                nth: 1,
                times,
                errno,
            }]);
            let filled = preallocated.fill(&[1; 5_000]);
            let error = filled.err().and_then(|it| it.raw_os_error());
            assert_eq!(error, (errno != libc::EINTR).then_some(errno));
            assert_eq!(faults.hits(), times);
        }
    }

    /// A message that fills its memory needs no change of the length, which a kernel without memory could refuse.
    #[test]
    fn only_a_shorter_message_changes_the_length_of_its_file() {
        for (len, changes) in [(5_000, None), (4_999, Some(1)), (0, Some(1))] {
            let preallocated = Preallocated::for_copies(5_000).unwrap();
            let calls = Injector::counting();
            let installed = calls.install();
            let file = File::from(preallocated.fill(&vec![1; len]).unwrap());
            drop(installed);
            assert_eq!(
                calls.counts().get(&Call::Truncate).copied(),
                changes,
                "{len}"
            );
            assert_eq!(file.metadata().unwrap().len(), len as u64);
        }
    }
}
