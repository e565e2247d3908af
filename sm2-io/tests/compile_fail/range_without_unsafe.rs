//! Only `unsafe` code can read from the address of pooled memory.

use sm2_io::PooledMapping;

fn read(mapping: &PooledMapping) -> usize {
    let range = mapping.range(0, 8).unwrap();
    let bytes: &[u8] = range.as_ref();
    bytes.len()
}

fn main() {}
