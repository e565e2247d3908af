//! Operations on both ends of one link.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_fuzz::link_pair(data));
