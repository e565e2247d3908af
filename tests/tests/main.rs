//! Tests with real processes and hostile peers, and of the repository itself.
//!
//! One program: its tests share one build and one link.

mod attacks;
mod confinement;
mod containers;
mod crash;
mod documents;
mod errors;
mod exhaustion;
mod faults;
mod isolation;
mod manager_descriptors;
mod manager_life;
mod manager_load;
mod many_nodes;
mod ring_call_processes;
mod ring_lane;
mod scale;
mod sessions;
mod shared_memory;
mod sizes;
mod takeover;
mod takeover_gap;
mod tidy;
mod users;
mod violations;
