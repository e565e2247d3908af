//! Bytes from a hostile Manager into a node.
// Shows CLI-TOTAL (libFuzzer).
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::node_session(data));
