//! Managers that take over from each other, and claims of any kind.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_fuzz::takeover(data));
