//! Messages whose bytes can all be checked: the publisher's instance, a number, and a pattern
//! that depends on both.

use std::hash::{BuildHasher, Hasher, RandomState};

use sm2_tests::pattern;

/// The length of instance and number: the length of the shortest message.
pub(crate) const HEADER_BYTES: usize = 16;

/// A number that no other process has, and no other publisher of this process.
pub(crate) fn new_instance() -> u64 {
    RandomState::new().build_hasher().finish()
}

/// Writes message `number` of a publisher into `bytes`, of at least [`HEADER_BYTES`].
pub(crate) fn fill(bytes: &mut [u8], instance: u64, number: u64) {
    let (header, rest) = bytes.split_at_mut(HEADER_BYTES);
    header[..8].copy_from_slice(&instance.to_le_bytes());
    header[8..].copy_from_slice(&number.to_le_bytes());
    pattern::fill(rest, instance ^ number);
}

/// The publisher's instance and the number, or `None` if a byte is wrong.
pub(crate) fn check(bytes: &[u8]) -> Option<(u64, u64)> {
    let (instance, rest) = bytes.split_first_chunk()?;
    let (number, rest) = rest.split_first_chunk()?;
    let (instance, number) = (u64::from_le_bytes(*instance), u64::from_le_bytes(*number));
    pattern::is_intact(rest, instance ^ number).then_some((instance, number))
}

#[cfg(test)]
mod tests {
    use super::{HEADER_BYTES, check, fill};

    #[test]
    fn a_changed_bit_is_found() {
        let mut bytes = [0; 100];
        fill(&mut bytes, 7, 9);
        assert_eq!(check(&bytes), Some((7, 9)));
        for byte in 0..bytes.len() {
            bytes[byte] ^= 4;
            assert_eq!(check(&bytes), None, "byte {byte}");
            bytes[byte] ^= 4;
        }
        assert_eq!(check(&bytes[..50]), None);
        assert_eq!(check(&bytes[..HEADER_BYTES - 1]), None);
    }
}
