//! Bytes from a hostile peer into the frames of a link.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::link_frames(data));
