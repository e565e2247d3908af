use crate::direction::{TO_MANAGER, TO_NODE};

/// The codec is compared with a decoder that was written from SPEC alone. Both read the same
/// control frames with the same contents, and name the same violation for all other bytes. The
/// first byte is the number of descriptors that came along.
//= SM2-FRM-001, SM2-FRM-002, SM2-FRM-003, SM2-NAM-001, SM2-TRN-010 fuzz
pub(crate) fn control_codec(data: &[u8]) {
    let Some((fds, frame)) = data.split_first() else {
        return;
    };
    let fds = usize::from(fds % 3);
    for direction in [TO_MANAGER, TO_NODE] {
        let agreed = direction.agrees(frame, fds);
        agreed.unwrap_or_else(|error| panic!("{error}"));
    }
}
