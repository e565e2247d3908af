//! Frames and headers from a hostile gateway into a session.
// Shows GW-SESSION (libFuzzer), bound: one connection, against plain sets of what both sides said.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::gateway_session(data));
