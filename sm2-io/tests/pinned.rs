//! Sealing while the kernel holds references to pages, for example in a pipe or during disk I/O.

use crate::common;
use std::os::fd::{AsFd, AsRawFd};

use nix::libc;
use sm2_io::SealedLoan;
use sm2_io::memfd::facts;
use sm2_proto::Seals;

#[test]
fn a_loan_whose_pages_are_in_a_pipe_is_sealed_all_the_same() {
    for len in [10_000, 3 << 20] {
        let mut loan = SealedLoan::new(len).unwrap();
        loan.as_mut_slice().fill(7);
        let (pipe, end) = nix::unistd::pipe().unwrap();
        let page = libc::iovec {
            iov_base: loan.as_mut_slice().as_mut_ptr().cast(),
            iov_len: 4096,
        };
        // SAFETY: the range is one page of the loan; the pipe keeps a reference, and no reader reads it.
        let lent = unsafe { libc::vmsplice(end.as_raw_fd(), &raw const page, 1, 0) };
        assert_eq!(lent, 4096);

        let start = std::time::Instant::now();
        let sealed = loan.seal().unwrap();
        println!("{len} bytes took {:?}", start.elapsed());

        let known = facts(sealed.as_fd()).unwrap();
        assert!(known.seals.contains(Seals::SEALED), "{known:?}");
        assert_eq!(known.size_bytes, len);
        let seen = common::map_sealed(&sealed, len, true);
        assert!(seen.as_slice().iter().all(|&byte| byte == 7));
        drop(pipe);
    }
}
