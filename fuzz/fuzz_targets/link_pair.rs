//! Operations on both ends of one link.
// Shows LNK-AGREE (libFuzzer), bound: topic and service, depth and borrowed up to 3.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_fuzz::link_pair(data));
