//! Beacons from anybody, and attempts to connect.
// Shows GW-FIND (libFuzzer), bound: four gateways, one of them this one.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_proto::fuzz::gateway_discovery(data));
