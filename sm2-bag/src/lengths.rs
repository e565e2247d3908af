//! The lengths inside a record, compared with its length. The parser of the crate `mcap` allocates the length that a
//! text claims, up to 4 GiB, before it reads the text.

use mcap::records::{Record, op};
use mcap::{McapError, McapResult};

/// The length of the opcode and the length field of a record, in bytes.
pub(crate) const RECORD_HEAD_BYTES: usize = 9;
/// The length of the head of a message, in bytes.
pub(crate) const MESSAGE_HEAD_BYTES: usize = 2 + 4 + 8 + 8;

/// A field of a record's body.
#[derive(Clone, Copy)]
enum Field {
    /// Numbers of so many bytes together.
    Numbers(usize),
    /// A text, or a map: 4 bytes with the length, then so many bytes.
    Text,
    /// 4 bytes with the length of all, then texts: keys and values in turn.
    TextMap,
}

/// The fields of a record up to its last text. None for records without texts, and for attachments, which are not
/// parsed here.
const fn fields(opcode: u8) -> &'static [Field] {
    use Field::{Numbers, Text, TextMap};
    match opcode {
        op::HEADER => &[Text, Text],
        // An array of numbers has the shape of a text.
        op::MESSAGE_INDEX => &[Numbers(2), Text],
        // The content of a schema has the shape of a text.
        op::SCHEMA => &[Numbers(2), Text, Text, Text],
        op::CHANNEL => &[Numbers(4), Text, Text, TextMap],
        op::CHUNK => &[Numbers(28), Text],
        // The numbers of a chunk index enclose a map of numbers, which has the shape of a text.
        op::CHUNK_INDEX => &[Numbers(32), Text, Numbers(8), Text],
        op::METADATA => &[Text, TextMap],
        op::METADATA_INDEX => &[Numbers(16), Text],
        op::ATTACHMENT_INDEX => &[Numbers(40), Text, Text],
        _ => &[],
    }
}

/// Reads the body of a record whose lengths fit into it.
pub(crate) fn parse(opcode: u8, body: &[u8]) -> McapResult<Record<'_>> {
    check(opcode, body)?;
    mcap::parse_record(opcode, body)
}

/// The bytes behind the fields of a record whose fields say where they end, if they fit into it; `None` of a record of
/// another kind. A later version of MCAP may append fields, so there can be some, but no program is known to write any.
pub(crate) fn behind_fields(opcode: u8, body: &[u8]) -> Option<&[u8]> {
    let says_end = matches!(
        opcode,
        op::HEADER | op::MESSAGE_INDEX | op::SCHEMA | op::CHANNEL | op::METADATA
    );
    check(opcode, body).ok().filter(|_| says_end)
}

/// Fails if a length in the body is longer than the bytes behind it. Returns the bytes behind the fields.
pub(crate) fn check(opcode: u8, mut body: &[u8]) -> McapResult<&[u8]> {
    for field in fields(opcode) {
        body = match *field {
            Field::Numbers(len) => split(body, len)?.1,
            Field::Text => text(body)?.1,
            Field::TextMap => {
                let (mut map, rest) = text(body)?;
                while !map.is_empty() {
                    map = text(map)?.1;
                }
                rest
            }
        };
    }
    Ok(body)
}

/// A text, and the bytes behind it.
pub(crate) fn text(bytes: &[u8]) -> McapResult<(&[u8], &[u8])> {
    let (len, rest) = bytes.split_first_chunk().ok_or(McapError::UnexpectedEoc)?;
    let len = usize::try_from(u32::from_le_bytes(*len));
    split(rest, len.map_err(|_| McapError::UnexpectedEoc)?)
}

pub(crate) fn split(bytes: &[u8], at: usize) -> McapResult<(&[u8], &[u8])> {
    bytes.split_at_checked(at).ok_or(McapError::UnexpectedEoc)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map of one key and one value, as it stands in a record.
    fn map(key_len: u32) -> Vec<u8> {
        let mut bytes = 10_u32.to_le_bytes().to_vec();
        bytes.extend(key_len.to_le_bytes());
        bytes.extend(b"k\x01\0\0\0v");
        bytes
    }

    #[test]
    fn a_length_beyond_the_record_is_refused_wherever_it_stands() {
        let opcodes = [
            op::SCHEMA,
            op::CHANNEL,
            op::CHUNK,
            op::CHUNK_INDEX,
            op::METADATA,
            op::METADATA_INDEX,
            op::ATTACHMENT_INDEX,
        ];
        for opcode in opcodes {
            let fields = fields(opcode);
            for wrong in 0..=fields.len() {
                let mut body = Vec::new();
                for (place, field) in fields.iter().enumerate() {
                    let long = u32::MAX.to_le_bytes();
                    match field {
                        Field::Numbers(len) => body.extend(vec![0; *len]),
                        _ if place == wrong => body.extend(long),
                        Field::Text => body.extend(b"\x02\0\0\0no"),
                        Field::TextMap => body.extend(map(1)),
                    }
                }
                let is_long = fields
                    .get(wrong)
                    .is_some_and(|it| !matches!(it, Field::Numbers(_)));
                assert_eq!(check(opcode, &body).is_err(), is_long, "{opcode} {wrong}");
            }
        }
    }

    #[test]
    fn a_text_in_a_map_ends_in_the_map() {
        let body = |key_len| [b"\x01\0\0\0m".as_slice(), &map(key_len), b"behind"].concat();
        assert!(check(op::METADATA, &body(1)).is_ok());
        for key_len in [2, 7, u32::MAX] {
            assert!(check(op::METADATA, &body(key_len)).is_err(), "{key_len}");
        }
    }

    #[test]
    fn the_fields_are_those_of_the_crate() {
        let metadata = mcap::records::Metadata {
            name: "name".into(),
            metadata: [("key".to_owned(), "value".to_owned())].into(),
        };
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = mcap::Writer::new(&mut bytes).unwrap();
        let schema = writer.add_schema("schema", "encoding", b"text").unwrap();
        let map = [("qos".to_owned(), "best".to_owned())].into();
        let channel = writer.add_channel(schema, "topic", "cdr", &map).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 1,
            log_time: 2,
            publish_time: 3,
        };
        writer.write_to_known_channel(&header, b"data").unwrap();
        writer.write_metadata(&metadata).unwrap();
        let attachment = mcap::Attachment {
            log_time: 4,
            create_time: 5,
            name: "map.png".to_owned(),
            media_type: "image/png".to_owned(),
            data: b"picture".as_slice().into(),
        };
        writer.attach(&attachment).unwrap();
        writer.finish().unwrap();
        drop(writer);
        let bytes = bytes.into_inner();
        let mut left = &bytes[mcap::MAGIC.len()..bytes.len() - mcap::MAGIC.len()];
        let mut seen = [false; 256];
        while let Some((head, rest)) = left.split_first_chunk::<9>() {
            let [opcode, len @ ..] = *head;
            let (body, after) = rest.split_at(u64::from_le_bytes(len) as usize);
            check(opcode, body).unwrap_or_else(|error| panic!("opcode {opcode}: {error}"));
            seen[usize::from(opcode)] = true;
            left = after;
        }
        for opcode in (0..=255).filter(|it| !fields(*it).is_empty()) {
            assert!(seen[usize::from(opcode)], "opcode {opcode} was not written");
        }
    }
}
