//! Bytes from another gateway, as frames, headers and beacons.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_fuzz::gateway_frames(data));
