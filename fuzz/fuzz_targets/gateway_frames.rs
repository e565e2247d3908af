//! Bytes from another gateway, as frames, headers and beacons.
// Shows GW-DECODE (libFuzzer), bound: bytes in any pieces, against a decoder written from SPEC alone.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_fuzz::gateway_frames(data));
