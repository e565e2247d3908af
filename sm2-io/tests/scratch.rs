//! Private memory takes space only for pages that were written.

use std::io::ErrorKind;

use sm2_io::Scratch;

#[test]
fn it_is_zero_and_keeps_what_is_written() {
    let mut scratch = Scratch::new(64 << 10).unwrap();
    assert_eq!(scratch.len(), 64 << 10);
    assert!(scratch.iter().all(|&byte| byte == 0));
    scratch[(64 << 10) - 1] = 7;
    assert_eq!(scratch.last(), Some(&7));
}

#[test]
fn there_is_none_without_bytes() {
    assert_eq!(Scratch::new(0).unwrap_err().kind(), ErrorKind::InvalidInput);
}
