//! Bytes as schema texts, and as a message of the first.
// Shows TYP-TOTAL, TYP-PAYLOAD (libFuzzer).
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_cli::fuzz::schema_text(data));
