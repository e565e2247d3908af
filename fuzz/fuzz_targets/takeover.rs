//! Managers that take over from each other, and claims of any kind.
// Shows CLI-SURVIVE, MGR-STRICT (libFuzzer), bound: 3 correct nodes and any Managers in turn, or 4 sessions with any
// claims against a book of claims.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_fuzz::takeover(data));
