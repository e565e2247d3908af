//! Replays the seeds and findings of `fuzz/` through the bodies of the fuzz targets.

#[path = "../../../fuzz/replay.rs"]
mod replay;

use sm2_cli::fuzz;

#[test]
fn every_seed() {
    replay::replay("command_line", fuzz::command_line);
    replay::replay("counters_page", fuzz::counters_page);
    replay::replay("schema_text", fuzz::schema_text);
}
