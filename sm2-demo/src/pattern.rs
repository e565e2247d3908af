//! The payload of the demo's messages. Its bytes depend on the message and on their position, so that
//! a stale, torn or shifted message is found. It is written and checked at about the speed of memory.
//!
//! The first 8 bytes are the number of the message. The words of 8 bytes after it form an arithmetic
//! progression that starts with the mixed number. The step is odd, so no two words of a message are
//! equal. If the last word does not fit, its first bytes are written.

use std::iter;

/// The shortest message: its number, and a word.
pub(crate) const MIN_BYTES: u64 = 16;

/// The number of words that are compared before the result is checked.
const BLOCK_WORDS: usize = 512;

/// 2^64 divided by the golden ratio; odd.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// An error: the message differs from the written one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Damage {
    /// The offset of the first wrong byte.
    pub(crate) offset: usize,
}

/// Writes message `number` over all of `message`, which is [`MIN_BYTES`] or longer.
pub(crate) fn fill(number: u64, message: &mut [u8]) {
    let (words, rest) = message.as_chunks_mut::<8>();
    let Some((first, body)) = words.split_first_mut() else {
        return;
    };
    *first = number.to_le_bytes();
    let mut word = start(number);
    for to in &mut *body {
        *to = word.to_le_bytes();
        word = word.wrapping_add(STEP);
    }
    rest.copy_from_slice(&word.to_le_bytes()[..rest.len()]);
}

/// Compares every byte of `message` with the bytes that [`fill`] writes, and returns its number.
pub(crate) fn check(message: &[u8]) -> Result<u64, Damage> {
    let (words, rest) = message.as_chunks::<8>();
    let Some((first, body)) = words.split_first() else {
        return Err(Damage { offset: 0 });
    };
    let number = u64::from_le_bytes(*first);
    let mut word = start(number);
    for (at, block) in body.chunks(BLOCK_WORDS).enumerate() {
        let before = word;
        let mut difference = 0;
        for from in block {
            difference |= u64::from_le_bytes(*from) ^ word;
            word = word.wrapping_add(STEP);
        }
        if difference != 0 {
            let offset = 8 + at * BLOCK_WORDS * 8 + first_difference(before, block.as_flattened());
            return Err(Damage { offset });
        }
    }
    match first_difference(word, rest) {
        at if at < rest.len() => Err(Damage {
            offset: message.len() - rest.len() + at,
        }),
        _ => Ok(number),
    }
}

/// The offset where `bytes` differ from the progression that starts with `word`; their length if
/// they do not differ.
fn first_difference(word: u64, bytes: &[u8]) -> usize {
    let words = iter::successors(Some(word), |word| Some(word.wrapping_add(STEP)));
    let expected = words.flat_map(u64::to_le_bytes);
    let equal = bytes.iter().zip(expected);
    equal
        .take_while(|(byte, expected)| *byte == expected)
        .count()
}

/// The finaliser of splitmix64: each bit of the number changes about half of the bits of the result.
const fn start(number: u64) -> u64 {
    let mut mixed = number.wrapping_add(STEP);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests;
