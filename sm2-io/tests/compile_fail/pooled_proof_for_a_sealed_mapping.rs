//! The proof of a pooled file does not prove that its bytes never change.

use sm2_io::SealedMapping;
use sm2_io::memfd::PooledFile;

fn map(file: &PooledFile) {
    let _ = SealedMapping::new(file, 1, false);
}

fn main() {}
