//! The integration tests of the wire formats and machines.
//!
//! One program: its tests share one build and one link.

#[path = "support/gateway_frames.rs"]
mod any_gateway_frames;
#[path = "support/claims.rs"]
mod claims;
#[path = "support/claims_oracle.rs"]
mod claims_oracle;
#[path = "support/claims_play.rs"]
mod claims_play;
#[path = "support/direction.rs"]
mod direction;
#[path = "link_support/driver.rs"]
mod driver;
#[path = "support/frames.rs"]
mod frames;
mod fuzzed;
#[path = "support/gateway/mod.rs"]
mod gateway;
mod link_support;
#[path = "support/naive_control.rs"]
mod naive;
#[path = "link_support/ops.rs"]
mod ops;
#[path = "link_support/pair.rs"]
mod pair;
mod ring_support;
mod support;
#[path = "support/takeover/mod.rs"]
mod takeover;

mod absence;
mod back_pressure;
mod backoff;
mod claims_model;
mod contract;
mod control_codec;
mod control_vectors;
mod counters;
mod deadline;
mod descriptors_lost;
mod domain_mirror;
mod domain_model;
mod domain_views;
mod example_in_memory;
mod fuzz_corpus;
mod gateway_beacon;
mod gateway_codec;
mod gateway_discovery;
mod gateway_frames;
mod gateway_routes;
mod gateway_rules;
mod gateway_schedule;
mod gateway_session;
mod gateway_vectors;
mod lifespan;
mod link_ends;
mod link_liveliness;
mod link_pair;
mod link_receiver;
mod link_ring_calls;
mod link_sender;
mod link_service;
mod link_table;
mod link_vectors;
mod link_violations;
mod lockstep_machines;
mod manager_access;
mod manager_adoption;
mod manager_asks;
mod manager_claims;
mod manager_ends;
mod manager_flow_control;
mod manager_limits;
mod manager_links;
mod manager_max_links;
mod manager_memory;
mod manager_pages;
mod manager_parts;
mod manager_refusals;
mod manager_reload;
mod manager_reload_requests;
mod manager_table;
mod manager_watch;
mod max_len;
mod node_asks;
mod node_resume;
mod node_rules;
mod node_table;
mod policy;
mod reload_model;
mod ring_calls_pair;
mod ring_calls_words;
mod ring_cells_calls;
mod ring_cells_receiver;
mod ring_cells_sender;
mod ring_cells_settled;
mod ring_cells_words;
mod ring_pair;
mod ring_receiver;
mod ring_sender;
mod ring_setup;
mod ring_vectors;
mod ring_words;
mod schema_vectors;
mod takeover_model;
mod texts;
