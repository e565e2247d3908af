//! The body of the fuzz target `schema_text`.

use alloc::format;
use core::str;

use super::{Layout, Root, Schema, hash};

/// Only the exact text of a schema is read, and a schema that was read is written as the same text.
//= SM2-TYP-001, SM2-TYP-002 fuzz
pub(crate) fn text(data: &[u8]) -> Option<[Schema; 2]> {
    let text = str::from_utf8(data).ok()?;
    // The text of a definition has lines of its own.
    let separator = if text.starts_with("cdr:") { '\0' } else { '\n' };
    let (one, other) = text.split_once(separator).unwrap_or((text, text));
    let (one, other) = (read(one)?, read(other)?);
    assert!(one != other || one.hash() == other.hash());
    Some([one, other])
}

fn read(text: &str) -> Option<Schema> {
    let schema = Schema::parse(text).ok()?;
    assert_eq!(format!("{schema}"), text);
    assert_eq!(Schema::parse(text).as_ref(), Ok(&schema));
    let ty = match schema.root() {
        Root::Type(ty) => ty,
        Root::Definition(_) => {
            let (first, _) = text.split_once('\n').expect("a line with the hash");
            assert_eq!(schema.hash(), hash::text(first));
            return Some(schema);
        }
    };
    let root = hash::message(schema.encoding().name(), ty.hash());
    assert_eq!(schema.hash(), root);
    if let Ok(layout) = Layout::of(ty) {
        assert_eq!(layout.elements(layout.fixed_bytes), Some(0));
        for bytes in [0, 1, layout.fixed_bytes + 1, u64::MAX] {
            if let Some(elements) = layout.elements(bytes) {
                let each = layout.element_bytes.unwrap_or(0);
                assert_eq!(layout.fixed_bytes + each * elements, bytes);
            }
        }
    }
    Some(schema)
}
