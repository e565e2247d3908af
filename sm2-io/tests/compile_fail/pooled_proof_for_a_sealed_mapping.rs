//! A file whose author can write is no proof that its bytes stay.

use sm2_io::SealedMapping;
use sm2_io::memfd::PooledFile;

fn map(file: &PooledFile) {
    let _ = SealedMapping::new(file, 1, false);
}

fn main() {}
