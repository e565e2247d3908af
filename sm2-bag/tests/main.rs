//! The integration tests of recording and playing.
//!
//! One program: its tests share one build and one link.

mod common;

mod black_box;
mod copy;
mod damage;
mod damaged_parts;
mod diff;
mod direct;
mod disk;
mod fuzz_corpus;
mod latched;
mod latched_play;
mod lockstep;
mod losses;
mod memory;
mod new_topics;
mod observer;
mod others;
mod parts;
mod play_clock;
mod play_control;
mod play_long;
mod power_cut;
mod record_and_play;
mod rewritten;
mod ros;
mod sessions;
mod wall_clock;
