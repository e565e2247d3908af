//! Harnesses for the numbers of links, from any count.

use super::Links;

//= SM2-LNK-002 kani
#[cfg_attr(kani, kani::proof)]
fn link_numbers_grow() {
    let mut links = Links::new(kani::any(), kani::any());
    links.last_serial = kani::any_where(|last: &u64| *last < u64::MAX - 1);
    let before = links.last_serial;
    let (one, key) = links.number();
    let (two, other_key) = links.number();
    assert!(before < one.serial && one.serial < two.serial);
    assert!(one.epoch == links.epoch() && two.epoch == links.epoch());
    kani::cover!(before > u64::from(u32::MAX), "a count beyond 32 bits");
    kani::cover!(key != other_key, "keys differ");
}

#[cfg(test)]
kani::explored! {
    link_numbers_grow: 2,
}
