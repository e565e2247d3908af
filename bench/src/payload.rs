//! The payload of messages. Its bytes depend on the message and on their position, so that a torn,
//! stale or shifted message is found. It is written and checked at the speed of memory.
//!
//! The first 32 bytes are four words: the number of the message, its flags, the time when its
//! writing began, and the time when it was handed to the peer (nanoseconds of the monotonic
//! clock, or 0). The words after the header are an arithmetic progression that starts with the
//! mixed number. The step is odd, so no two words of a message are equal. If the last word does not
//! fit, its first bytes are written.

use std::iter;

/// The length of the header, and of the shortest message, in bytes.
pub const HEADER_BYTES: usize = 32;

/// The flag of messages that belong to the counted part of a run.
pub const COUNTED: u64 = 1;

/// 2^64 divided by the golden ratio; odd.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// The number of words that are compared before the result is checked.
const BLOCK_WORDS: usize = 2_048;

/// The shortest message that makes the code check the processor's features; shorter ones would be
/// slowed down by it.
const WIDE_BYTES: usize = 1_024;

/// The header of a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// The number of the message, which increases with each message of a publisher.
    pub number: u64,
    /// [`COUNTED`], or 0.
    pub flags: u64,
    /// The time when the publisher began to write the message, in nanoseconds; 0 without stamps.
    pub start_ns: u64,
    /// The time when the message was handed to the peer, in nanoseconds; 0 without stamps.
    pub handed_ns: u64,
}

/// An error: the message differs from the written one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Torn;

/// Writes all of `message`, which is [`HEADER_BYTES`] or longer.
pub fn fill(header: Header, message: &mut [u8]) {
    let (head, body) = message.split_at_mut(HEADER_BYTES);
    let words = [
        header.number,
        header.flags,
        header.start_ns,
        header.handed_ns,
    ];
    for (to, word) in head.as_chunks_mut::<8>().0.iter_mut().zip(words) {
        *to = word.to_le_bytes();
    }
    fill_body(mixed(header.number), body);
}

/// Sets the time of handing over in a written message.
pub fn stamp(message: &mut [u8], handed_ns: u64) {
    message[24..HEADER_BYTES].copy_from_slice(&handed_ns.to_le_bytes());
}

/// Reads the header and nothing else.
///
/// # Errors
///
/// [`Torn`] if the message is shorter than the header.
pub fn peek(message: &[u8]) -> Result<Header, Torn> {
    let (words, _) = message.as_chunks::<8>();
    let [number, flags, start_ns, handed_ns, ..] = *words else {
        return Err(Torn);
    };
    Ok(Header {
        number: u64::from_le_bytes(number),
        flags: u64::from_le_bytes(flags),
        start_ns: u64::from_le_bytes(start_ns),
        handed_ns: u64::from_le_bytes(handed_ns),
    })
}

/// Compares every byte with what [`fill`] writes.
///
/// # Errors
///
/// [`Torn`] if a byte differs.
pub fn check(message: &[u8]) -> Result<Header, Torn> {
    let header = peek(message)?;
    if body_is_whole(mixed(header.number), &message[HEADER_BYTES..]) {
        Ok(header)
    } else {
        Err(Torn)
    }
}

fn fill_body(start: u64, body: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    if body.len() >= WIDE_BYTES && is_x86_feature_detected!("avx2") {
        // SAFETY: this processor has AVX2, as was just asked.
        return unsafe { fill_avx2(start, body) };
    }
    fill_words(start, body);
}

fn body_is_whole(start: u64, body: &[u8]) -> bool {
    #[cfg(target_arch = "x86_64")]
    if body.len() >= WIDE_BYTES && is_x86_feature_detected!("avx2") {
        // SAFETY: this processor has AVX2, as was just asked.
        return unsafe { compare_avx2(start, body) };
    }
    compare_words(start, body)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn fill_avx2(start: u64, body: &mut [u8]) {
    fill_words(start, body);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn compare_avx2(start: u64, body: &[u8]) -> bool {
    compare_words(start, body)
}

#[inline(always)]
fn fill_words(start: u64, body: &mut [u8]) {
    let (words, rest) = body.as_chunks_mut::<8>();
    let mut word = start;
    for to in words {
        *to = word.to_le_bytes();
        word = word.wrapping_add(STEP);
    }
    let len = rest.len();
    rest.copy_from_slice(&word.to_le_bytes()[..len]);
}

#[inline(always)]
fn compare_words(start: u64, body: &[u8]) -> bool {
    let (words, rest) = body.as_chunks::<8>();
    let mut word = start;
    for block in words.chunks(BLOCK_WORDS) {
        let mut difference = 0;
        for from in block {
            difference |= u64::from_le_bytes(*from) ^ word;
            word = word.wrapping_add(STEP);
        }
        if difference != 0 {
            return false;
        }
    }
    iter::zip(rest, word.to_le_bytes()).all(|(byte, expected)| *byte == expected)
}

/// A number that looks random, the same one for equal arguments.
#[must_use]
pub const fn scattered(number: u64) -> u64 {
    mixed(number)
}

/// The finaliser of splitmix64: each bit of the number changes about half of the bits of the result.
const fn mixed(number: u64) -> u64 {
    let mut mixed = number.wrapping_add(STEP);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
#[path = "payload/tests.rs"]
mod tests;
