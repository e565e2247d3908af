//! The integration tests of the library for nodes.
//!
//! One program: its tests share one build and one link.

mod common;

mod asynchronous;
mod away;
mod back_pressure;
mod background;
mod clock;
mod counters;
mod deadline;
mod deaths;
mod derive;
mod detach;
mod domain;
mod embedded;
mod event_loop;
mod events;
mod examples;
mod executor;
mod executor_calls;
mod executor_ends;
mod explain;
mod full_socket;
mod fuzz_corpus;
mod hostile;
mod hostile_manager;
mod leaks;
mod lifespan;
mod lifetimes;
mod liveliness;
mod lock;
mod manager_change;
mod many;
mod mapped_bytes;
mod max_len;
mod outlived;
mod params;
mod pool_limit;
mod qos;
mod reserve;
mod resident;
mod ring;
mod ring_calls;
mod ring_waits;
mod room;
mod schema;
mod sealed;
mod services;
mod shortage;
mod shutdown;
mod testing;
mod topics;
mod wait_set;
mod wait_set_calls;
mod wait_set_sources;
