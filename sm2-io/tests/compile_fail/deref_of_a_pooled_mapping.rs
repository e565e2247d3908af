//! Pooled memory changes under its readers: it does not dereference to bytes.

use sm2_io::PooledMapping;

fn deref(mapping: &PooledMapping) -> u8 {
    mapping[0]
}

fn main() {}
