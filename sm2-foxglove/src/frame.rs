//! Frames of the WebSocket protocol to a viewer (RFC 6455, section 5.2).
//!
//! `tungstenite` reads the frames of viewers, and answers their control frames. This server writes frames itself: a
//! message is then in memory once, and a long message that leaves in many small parts is not moved after each of them.

use crate::outbox::Frame;

/// The bits of a frame that is a whole message, and its opcode.
const TEXT: u8 = 0x81;
const BINARY: u8 = 0x82;

/// The longest head of a frame without a mask.
pub(crate) const HEAD_MAX: usize = 10;

/// The frame of a text.
pub(crate) fn text(text: &str) -> Frame {
    frame(TEXT, &[text.as_bytes()])
}

/// The frame of a binary message, whose parts are concatenated.
pub(crate) fn binary(parts: &[&[u8]]) -> Frame {
    frame(BINARY, parts)
}

fn frame(first: u8, parts: &[&[u8]]) -> Frame {
    let len: usize = parts.iter().map(|it| it.len()).sum();
    let mut frame = Vec::with_capacity(HEAD_MAX + len);
    frame.push(first);
    match len {
        0..=125 => frame.push(len as u8),
        126..=0xffff => {
            frame.push(126);
            frame.extend((len as u16).to_be_bytes());
        }
        _ => {
            frame.push(127);
            frame.extend((len as u64).to_be_bytes());
        }
    }
    for part in parts {
        frame.extend_from_slice(part);
    }
    frame
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use tungstenite::{Message, WebSocket, protocol::Role};

    use super::*;

    #[test]
    fn another_implementation_reads_the_frames() {
        for len in [0, 1, 125, 126, 127, 65_535, 65_536, 1_000_000] {
            let payload = vec![7; len];
            let mut frames = text(&"x".repeat(len));
            frames.extend(binary(&[&payload[..len / 2], &payload[len / 2..]]));
            let mut socket = WebSocket::from_raw_socket(Cursor::new(frames), Role::Client, None);
            assert_eq!(socket.read().unwrap(), Message::text("x".repeat(len)));
            assert_eq!(socket.read().unwrap(), Message::binary(payload));
        }
    }
}
