//! Large mappings start at a multiple of 2 MiB, and are unmapped. Alone in its process: another thread could
//! take the address range that was chosen.

use crate::common::map_sealed;
use sm2_io::memfd::sealed_from_bytes;
use sm2_io::{SealedLoan, Segment};
use sm2_test_support::ran_alone;

const HUGE: usize = 2 << 20;

fn mappings() -> usize {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    maps.lines()
        .filter(|line| line.contains("/memfd:sm2-"))
        .count()
}

#[test]
fn large_mappings_are_aligned_and_all_are_unmapped() {
    if ran_alone(concat!(
        module_path!(),
        "::large_mappings_are_aligned_and_all_are_unmapped"
    )) {
        return;
    }
    for len in [HUGE, HUGE + 1, 3 * HUGE, 5 * HUGE + 4097] {
        let mut loan = SealedLoan::new(len as u64).unwrap();
        assert_eq!(loan.as_mut_slice().as_ptr().addr() % HUGE, 0);
        let fd = loan.seal().unwrap();
        let mapping = map_sealed(&fd, len as u64, false);
        assert_eq!(mapping.as_ptr().addr() % HUGE, 0);
        let segment = Segment::create(len as u64, 2).unwrap();
        assert_eq!(segment.slot_ptr(0).addr() % HUGE, 0);
        assert_eq!(segment.slot_ptr(1).addr() - segment.slot_ptr(0).addr(), len);
        assert_eq!(mappings(), 2);
    }
    for len in [1, 4096, 4097] {
        let fd = sealed_from_bytes(&vec![1; len]).unwrap();
        let _mapping = map_sealed(&fd, len as u64, true);
        assert_eq!(mappings(), 1);
    }
    assert_eq!(mappings(), 0);
}
