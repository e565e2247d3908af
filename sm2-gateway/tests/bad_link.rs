//! Two domains with a bad link of the kernel between them. Faults of the network never affect a local node, and
//! the other domain receives what the network lets through. No assertion depends on the speed of
//! the machine; rates and ages are printed for people.

mod camera;
mod roaming;
mod world;
