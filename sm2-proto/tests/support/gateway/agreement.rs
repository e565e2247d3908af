//! Checks that the decoders of the crate agree with the naive ones, and that no other bytes have
//! the meaning of accepted bytes. Each function panics if a check fails.

use serde_json::Value;
use sm2_proto::gateway::{
    Beacon, BeaconError, Frame, FrameReader, HEADER_LEN, Header, PeerViolation,
};

use super::{json, naive};

/// The frames of a control stream, then whether the stream may end here, or the violation.
type Read = (Vec<Frame>, Result<bool, PeerViolation>);

pub(crate) fn body(bytes: &[u8]) {
    let frame = Frame::from_body(bytes);
    if let Ok(frame) = &frame {
        assert_eq!(&frame.to_bytes()[4..], bytes, "one encoding");
    }
    let meaning = frame.as_ref().map(json::frame);
    let meaning = meaning.map_err(|violation| violation.kind().name());
    assert_eq!(meaning, naive::body(bytes), "{bytes:02x?}");
}

/// Feeds the stream in pieces whose lengths repeat `pieces`.
pub(crate) fn stream(bytes: &[u8], pieces: &[usize]) {
    let at_once = in_pieces(bytes, &[usize::MAX]);
    assert_eq!(in_pieces(bytes, pieces), at_once, "whatever the pieces");
    let (frames, end) = at_once;
    let (naive, left) = naive::stream(bytes);
    let meaning: Vec<Value> = frames.iter().map(json::frame).collect();
    assert_eq!(meaning, naive, "{bytes:02x?}");
    let could_end = left.map(|left| left == 0);
    assert_eq!(end.map_err(|it| it.kind().name()), could_end);
    let again: Vec<u8> = frames.iter().flat_map(Frame::to_bytes).collect();
    assert!(bytes.starts_with(&again), "one encoding");
    if let Ok(left) = left {
        assert_eq!(again.len() + left, bytes.len());
    }
}

fn in_pieces(bytes: &[u8], pieces: &[usize]) -> Read {
    let mut reader = FrameReader::default();
    let mut frames = Vec::new();
    let (mut rest, mut pieces) = (bytes, pieces.iter().cycle());
    while !rest.is_empty() {
        let len = pieces.next().copied().unwrap_or(1).clamp(1, rest.len());
        let (piece, behind) = rest.split_at(len);
        reader.push(piece);
        loop {
            match reader.next_frame() {
                Ok(Some(frame)) => frames.push(frame),
                Ok(None) => break,
                Err(violation) => {
                    assert_eq!(reader.next_frame(), Err(violation), "it stays wrong");
                    return (frames, Err(violation));
                }
            }
        }
        rest = behind;
    }
    (frames, Ok(reader.is_between_frames()))
}

pub(crate) fn header(bytes: &[u8; HEADER_LEN]) {
    let header = Header::from_bytes(bytes);
    if let Ok(header) = &header {
        assert_eq!(&header.to_bytes(), bytes, "one encoding");
    }
    let meaning = header.as_ref().map(json::header);
    let meaning = meaning.map_err(|violation| violation.kind().name());
    assert_eq!(meaning, naive::header(bytes), "{bytes:02x?}");
}

pub(crate) fn beacon(bytes: &[u8]) {
    let beacon = Beacon::from_bytes(bytes);
    if let Ok(beacon) = &beacon {
        assert_eq!(beacon.to_bytes().as_slice(), bytes, "one encoding");
    }
    let meaning = beacon.as_ref().map(json::beacon);
    let meaning = meaning.map_err(|why: &BeaconError| json::beacon_error(*why));
    assert_eq!(meaning, naive::beacon(bytes), "{bytes:02x?}");
}
