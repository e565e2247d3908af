//! Pages, changes and counters of a hostile Manager into what tools show.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::domain_mirror(data));
