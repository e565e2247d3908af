//! Harnesses for the grammar of names, against SPEC section 2 read word by word.

use super::{Fault, check};
use crate::{
    limits::NAME_MAX,
    proofs::{below, one_of},
};

/// Both ends of each range of bytes that a name may have, and their neighbours.
const BYTES: [u8; 22] = *b"az{`AZ[@09:/._^-,. \0\x7f\xff";

fn is_legal_byte(byte: u8) -> bool {
    byte.is_ascii_lowercase()
        || byte.is_ascii_uppercase()
        || byte.is_ascii_digit()
        || byte == b'_'
        || byte == b'-'
}

/// SM2-NAM-001: segments joined by single slashes, none of them empty.
fn is_name(bytes: &[u8]) -> bool {
    let mut segments = bytes.split(|byte| *byte == b'/');
    bytes.len() <= 255
        && segments
            .all(|segment| !segment.is_empty() && segment.iter().all(|it| is_legal_byte(*it)))
}

/// NAM-GRAMMAR: any text of up to three of the bytes where the grammar changes.
//= SM2-NAM-001 kani
// Shows NAM-GRAMMAR (Exhaustive), bound: up to 3 bytes, of 22 around which the grammar changes.
#[cfg_attr(kani, kani::proof)]
// Four bytes.
#[cfg_attr(kani, kani::unwind(6))]
fn names_follow_the_grammar() {
    let len = below(4);
    let mut bytes = [0; 3];
    for byte in bytes.iter_mut().take(len) {
        *byte = one_of(&BYTES);
    }
    let bytes = &bytes[..len];
    let verdict = check(bytes);
    assert_eq!(verdict.is_ok(), is_name(bytes));
    let empty = Err(Fault::Empty);
    assert_eq!(verdict == empty, bytes.is_empty());
    if let Err(Fault::BadByte(at) | Fault::EmptySegment(at)) = verdict {
        // The bytes before it are the beginning of a name.
        let before = bytes[..at].strip_suffix(b"/").unwrap_or(&bytes[..at]);
        assert!(before.is_empty() || is_name(before));
    }
    kani::cover!(verdict.is_ok() && bytes[len / 2] == b'/', "two segments");
    kani::cover!(verdict == Err(Fault::EmptySegment(1)), "an empty segment");
    kani::cover!(verdict == Err(Fault::BadByte(2)), "no byte of a name");
}

/// Any byte at any place of a name of any length up to one too many.
//= SM2-NAM-001 kani
// Shows NAM-GRAMMAR (Exhaustive), bound: lengths 1, 2, 3, 254, 255, 256.
#[cfg_attr(kani, kani::proof)]
// 256 bytes: one more than a name may have.
#[cfg_attr(kani, kani::unwind(258))]
fn names_have_their_length() {
    const MOST: usize = NAME_MAX + 1;
    let len = one_of(&[1, 2, 3, 254, NAME_MAX, MOST]);
    // At the ends, in the middle, and beside them.
    let at = one_of(&[0, 1, 2, len / 2, len - 1, len.saturating_sub(2)]);
    let byte = kani::any();
    let mut bytes = [b'n'; MOST];
    kani::assume(at < len);
    bytes[at] = byte;
    let verdict = check(&bytes[..len]);
    let inside = byte == b'/' && at > 0 && at + 1 < len;
    if len > NAME_MAX {
        assert_eq!(verdict, Err(Fault::TooLong(len)));
    } else if is_legal_byte(byte) || inside {
        assert_eq!(verdict, Ok(()));
    } else if byte == b'/' {
        assert_eq!(verdict, Err(Fault::EmptySegment(at)));
    } else {
        assert_eq!(verdict, Err(Fault::BadByte(at)));
    }
    kani::cover!(
        len == NAME_MAX && inside && verdict.is_ok(),
        "the longest name"
    );
    kani::cover!(len == MOST, "one byte too long");
}

#[cfg(test)]
kani::explored! {
    names_follow_the_grammar: 3,
    names_have_their_length: 2,
}
