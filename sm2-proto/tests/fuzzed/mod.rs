//! The bodies of the fuzz targets that compare with an oracle, beside the oracles.
//!
//! `fuzz_corpus.rs` replays them, and `fuzz/src/lib.rs` compiles them for libFuzzer. Both declare
//! at their root the modules that these bodies use.

mod control_codec;
mod gateway_frames;
mod link_pair;
mod takeover;

pub(crate) use self::{
    control_codec::control_codec, gateway_frames::gateway_frames, link_pair::link_pair,
    takeover::takeover,
};
