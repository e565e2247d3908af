//! Words as command lines, and as all that people write in them.
// Shows CMD-WORDS (libFuzzer).
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_cli::fuzz::command_line(data));
