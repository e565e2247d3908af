//! The bodies of fuzz targets that live beside the oracles in the tests of `sm2-proto`.

#[path = "../../sm2-proto/tests/support/claims_oracle.rs"]
mod claims_oracle;
#[path = "../../sm2-proto/tests/support/claims_play.rs"]
mod claims_play;
#[path = "../../sm2-proto/tests/support/direction.rs"]
#[allow(dead_code, reason = "a part is for random tests")]
mod direction;
#[path = "../../sm2-proto/tests/link_support/driver.rs"]
mod driver;
#[path = "../../sm2-proto/tests/fuzzed/mod.rs"]
mod fuzzed;
#[path = "../../sm2-proto/tests/support/gateway/mod.rs"]
mod gateway;
#[path = "../../sm2-proto/tests/link_support/mod.rs"]
mod link_support;
#[path = "../../sm2-proto/tests/support/naive_control.rs"]
mod naive;
#[path = "../../sm2-proto/tests/link_support/ops.rs"]
#[allow(dead_code, reason = "a part is for random tests")]
mod ops;
#[path = "../../sm2-proto/tests/link_support/pair.rs"]
mod pair;
#[path = "../../sm2-proto/tests/support/mod.rs"]
mod support;
#[path = "../../sm2-proto/tests/support/takeover/mod.rs"]
mod takeover;

/// The control codec and its naive twin, on the same bytes.
pub fn control_codec(data: &[u8]) {
    fuzzed::control_codec(data);
}

/// Frames of gateways: the decoders and their naive twins, on the same bytes.
pub fn gateway_frames(data: &[u8]) {
    fuzzed::gateway_frames(data);
}

/// Operations on both ends of one link.
pub fn link_pair(data: &[u8]) {
    fuzzed::link_pair(data);
}

/// Managers that take over, and claims.
pub fn takeover(data: &[u8]) {
    fuzzed::takeover(data);
}
