//! Bytes from a hostile node into a Manager session.
// Shows MGR-TOTAL (libFuzzer).
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::manager_session(data));
