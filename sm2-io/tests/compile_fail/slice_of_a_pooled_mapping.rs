//! Pooled memory changes under its readers: there is no slice of it.

use sm2_io::PooledMapping;

fn slice(mapping: &PooledMapping) -> &[u8] {
    mapping.as_slice()
}

fn main() {}
