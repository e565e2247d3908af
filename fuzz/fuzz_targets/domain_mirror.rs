//! Pages, changes and counters of a hostile Manager into what tools show.
// Shows MGR-MIRROR (libFuzzer).
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_node::fuzz::domain_mirror(data));
