//! Bytes as control frames, to the codec and to a naive decoder.
// Shows DECODE-CONTROL (libFuzzer), bound: bytes, against a decoder written from SPEC alone.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_fuzz::control_codec(data));
