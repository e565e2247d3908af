//! Files as bags, and small bags whose bytes are changed.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_bag::fuzz::bag_file(data));
