//! Files as bags, and small bags whose bytes are changed.
// Shows BAG-TOTAL (libFuzzer), bound: a bag of up to 3 channels and 12 messages before its bytes are changed.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_bag::fuzz::bag_file(data));
