//! Two domains with a bad link between them. Faults of the network never affect a local node, and
//! the other domain receives what the network lets through. No assertion depends on the speed of
//! the machine; rates and ages are printed for people.

#[path = "bad_link/camera.rs"]
mod camera;
mod common;
#[path = "bad_link/datagrams.rs"]
mod datagrams;
#[path = "bad_link/killed.rs"]
mod killed;
#[path = "bad_link/roaming.rs"]
mod roaming;
#[path = "bad_link/traffic.rs"]
mod traffic;
#[path = "bad_link/world.rs"]
mod world;
