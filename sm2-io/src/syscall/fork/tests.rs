use std::collections::BTreeSet;

use super::*;

#[test]
fn each_number_has_a_bit_of_its_own() {
    let mut bits = BTreeSet::new();
    for number in 0..NUMBERS {
        let (word, bit) = place(RawFd::try_from(number).unwrap()).unwrap();
        assert_eq!(bit.count_ones(), 1, "{number}");
        assert!(bits.insert((std::ptr::from_ref(word), bit)), "{number}");
    }
    for number in [-1, RawFd::try_from(NUMBERS).unwrap(), RawFd::MAX] {
        assert!(place(number).is_none(), "{number}");
    }
}
