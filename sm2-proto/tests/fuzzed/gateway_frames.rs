use crate::gateway::agreement;

/// The decoders of the crate and the naive ones accept the same bytes with the same meaning, and refuse
/// all others for the same reason, for pieces of any length. The first byte says how many of the next
/// bytes are lengths of pieces.
//= SM2-GWF-002, SM2-GWO-007, SM2-GWM-002, SM2-GWD-001, SM2-FRM-001, SM2-FRM-002, SM2-NAM-001 fuzz
pub(crate) fn gateway_frames(data: &[u8]) {
    let Some((count, data)) = data.split_first() else {
        return;
    };
    let (pieces, bytes) = data.split_at(usize::from(count % 4).min(data.len()));
    let pieces: Vec<usize> = pieces.iter().map(|it| usize::from(*it)).collect();
    agreement::stream(bytes, &pieces);
    agreement::body(bytes);
    agreement::beacon(bytes);
    if let Some(header) = bytes.first_chunk() {
        agreement::header(header);
    }
}
