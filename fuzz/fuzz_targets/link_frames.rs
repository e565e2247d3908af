//! Bytes from a hostile peer into the frames of a link.
// Shows LNK-TOTAL, DAT-BOUNDS (libFuzzer), bound: any role, depth and borrowed up to 3, segments of 4,096-byte slots.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::link_frames(data));
