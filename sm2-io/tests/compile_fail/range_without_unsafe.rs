//! The address of pooled memory is readable by `unsafe` code alone.

use sm2_io::PooledMapping;

fn read(mapping: &PooledMapping) -> usize {
    let range = mapping.range(0, 8).unwrap();
    let bytes: &[u8] = range.as_ref();
    bytes.len()
}

fn main() {}
