//! Sealing while another mapping holds the pages. In its own file, because it searches the descriptors of the
//! whole process for the loan.

use crate::common;
use sm2_test_support::ran_alone;
use std::fs::{self, OpenOptions};
use std::os::fd::{AsFd, OwnedFd};

use sm2_io::{SealedLoan, memfd};
use sm2_proto::Seals;

/// Opens the only loan of this process a second time.
fn the_loan() -> OwnedFd {
    let all = fs::read_dir("/proc/self/fd").unwrap();
    let path = all
        .map(|entry| entry.unwrap().path())
        .find(|path| {
            fs::read_link(path).is_ok_and(|to| to.to_string_lossy().contains("memfd:sm2-message"))
        })
        .expect("the loan's descriptor");
    let file = OpenOptions::new().read(true).write(true).open(path);
    file.unwrap().into()
}

#[test]
fn a_loan_whose_pages_are_held_is_sealed_all_the_same() {
    if ran_alone(concat!(
        module_path!(),
        "::a_loan_whose_pages_are_held_is_sealed_all_the_same"
    )) {
        return;
    }
    let mut loan = SealedLoan::new(10_000).unwrap();
    loan.as_mut_slice().fill(7);
    // The kernel refuses the seal as long as another writable mapping exists.
    let file = the_loan();
    let len = std::num::NonZeroUsize::new(10_000).unwrap();
    // SAFETY: a new mapping at an address that the kernel chooses; nothing is read from it.
    let held = unsafe {
        nix::sys::mman::mmap(
            None,
            len,
            nix::sys::mman::ProtFlags::PROT_WRITE,
            nix::sys::mman::MapFlags::MAP_SHARED,
            file.as_fd(),
            0,
        )
    };
    let held = held.unwrap();
    let sealed = loan.seal().unwrap();
    let facts = memfd::facts(sealed.as_fd()).unwrap();
    assert!(facts.seals.contains(Seals::SEALED), "{facts:?}");
    assert_eq!(facts.size_bytes, 10_000);
    let seen = common::map_sealed(&sealed, 10_000, false);
    assert!(seen.as_slice().iter().all(|&byte| byte == 7));
    // SAFETY: the mapping made above, with its length; no reference to it exists.
    unsafe { nix::sys::mman::munmap(held, 10_000) }.unwrap();
}
