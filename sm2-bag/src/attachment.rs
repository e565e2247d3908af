//! Attachments: files that a program has put into a bag.

use std::borrow::Cow;

use mcap::{Attachment, McapError, McapResult};

use crate::checksum;
use crate::lengths::{split, text};

/// Parses the body of an attachment, and verifies its checksum. The parser of the crate `mcap` panics on a short one.
pub(crate) fn parse(body: &[u8]) -> McapResult<Attachment<'_>> {
    let (covered, crc) = body.split_last_chunk().ok_or(McapError::UnexpectedEoc)?;
    let (times, rest) = split(covered, 16)?;
    let (name, rest) = text(rest)?;
    let (media_type, rest) = text(rest)?;
    let (len, data) = rest.split_first_chunk().ok_or(McapError::UnexpectedEoc)?;
    if u64::from_le_bytes(*len) != data.len() as u64 {
        return Err(McapError::UnexpectedEoc);
    }
    let saved = u32::from_le_bytes(*crc);
    let calculated = crc32fast::hash(covered);
    if !checksum::is_right(saved, calculated) {
        return Err(McapError::BadAttachmentCrc { saved, calculated });
    }
    let time = |at: usize| {
        let bytes = times.get(at..).and_then(|it| it.first_chunk());
        u64::from_le_bytes(bytes.copied().unwrap_or_default())
    };
    let string = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Ok(Attachment {
        log_time: time(0),
        create_time: time(8),
        name: string(name),
        media_type: string(media_type),
        data: Cow::Borrowed(data),
    })
}
