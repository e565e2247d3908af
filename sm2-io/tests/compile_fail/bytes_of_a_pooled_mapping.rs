//! Pooled memory changes under its readers: there is no slice of a part of it.

use sm2_io::PooledMapping;

fn bytes(mapping: &PooledMapping) -> Option<&[u8]> {
    mapping.bytes(0, 8)
}

fn main() {}
