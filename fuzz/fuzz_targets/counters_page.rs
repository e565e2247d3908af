//! Words of a hostile node in the file of its counters.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_cli::fuzz::counters_page(data));
