//! Words of a hostile peer into one end of a link of the ring lane.
// Shows RNG-HOSTILE (libFuzzer).
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::ring_words(data));
