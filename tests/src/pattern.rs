//! Payloads that can be checked: the bytes depend on the number and the length of the message.

/// Fills `payload` with the bytes of message `number`.
pub fn fill(payload: &mut [u8], number: u64) {
    let mut words = Words::of(number, payload.len());
    let mut chunks = payload.chunks_exact_mut(8);
    for chunk in &mut chunks {
        chunk.copy_from_slice(&words.next());
    }
    let rest = chunks.into_remainder();
    let len = rest.len();
    rest.copy_from_slice(&words.next()[..len]);
}

/// Message `number` with this length.
#[must_use]
pub fn message(number: u64, len: usize) -> Vec<u8> {
    let mut payload = vec![0; len];
    fill(&mut payload, number);
    payload
}

/// True if every byte of `payload` is that of message `number`.
#[must_use]
pub fn is_intact(payload: &[u8], number: u64) -> bool {
    let mut words = Words::of(number, payload.len());
    let mut chunks = payload.chunks_exact(8);
    let intact = chunks.by_ref().all(|chunk| chunk == words.next());
    let rest = chunks.remainder();
    intact && *rest == words.next()[..rest.len()]
}

/// Knuth's linear congruential generator.
const FACTOR: u64 = 6_364_136_223_846_793_005;
const INCREMENT: u64 = 1_442_695_040_888_963_407;

/// Words that depend on the number and length of the message, and on their position.
struct Words(u64);

impl Words {
    const fn of(number: u64, len: usize) -> Self {
        Self(number.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ len as u64)
    }

    const fn next(&mut self) -> [u8; 8] {
        self.0 = self.0.wrapping_mul(FACTOR).wrapping_add(INCREMENT);
        self.0.to_le_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::{is_intact, message};

    #[test]
    fn every_bit_counts() {
        for len in [1, 7, 8, 9, 4097] {
            let good = message(5, len);
            assert!(is_intact(&good, 5));
            assert!(!is_intact(&good, 6), "{len} bytes of another message");
            assert!(len == 1 || !is_intact(&good[1..], 5), "the end of {len}");
            assert!(
                len == 1 || !is_intact(&good[..len - 1], 5),
                "a part of {len}"
            );
            for byte in 0..len {
                let mut bad = good.clone();
                bad[byte] ^= 0x10;
                assert!(!is_intact(&bad, 5), "byte {byte} of {len}");
            }
        }
    }
}
