//! Small random edits of a frame, which most often make it invalid.

/// Inserts, removes or changes one byte at a random position, or cuts the frame off there.
pub(crate) fn edit(bytes: &mut Vec<u8>, (at, byte, edit): (u16, u8, u8)) {
    let at = usize::from(at) % (bytes.len() + 1);
    match edit % 6 {
        0 => bytes.insert(at, byte),
        1 if at < bytes.len() => drop(bytes.remove(at)),
        2 => bytes.truncate(at),
        // A longer varint of the same value, if one ends here.
        3 if at < bytes.len() && bytes[at] < 0x80 => {
            bytes[at] |= 0x80;
            bytes.insert(at + 1, 0);
        }
        4 if at < bytes.len() => bytes[at] ^= 1 << (byte % 8),
        _ if at < bytes.len() => bytes[at] = byte,
        _ => {}
    }
}
