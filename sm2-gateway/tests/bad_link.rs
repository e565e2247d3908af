//! Two domains with a bad link between them: what the network does, no local node feels, and the
//! other domain gets what the network lets through. Nothing here depends on how fast the machine is;
//! rates and ages are printed for people.

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
