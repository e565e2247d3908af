//! Words of a hostile node in the file of its counters.
// Shows CNT-TOTAL (libFuzzer), bound: up to 3 entries, a file that nobody changes meanwhile.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_cli::fuzz::counters_page(data));
