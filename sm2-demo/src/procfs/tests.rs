use std::process;

use super::*;

#[test]
fn processor_time_is_found_behind_any_name() {
    let stat = "42 (a) (b c) R 1 42 42 0 -1 4194304 90 0 0 0 17 5 0 0 20 0 1 0 100 0 0";
    assert_eq!(ticks(stat), Some(22));
    assert_eq!(ticks("42 (a) R 1"), None);
    assert_eq!(ticks(""), None);
}

#[test]
fn the_share_of_memory_is_in_bytes() {
    let rollup = "5580-7ffd ---p 00000000 00:00 0    [rollup]\n\
                  Rss:                1856 kB\nPss:                 409 kB\nPss_Dirty: 96 kB\n";
    assert_eq!(pss(rollup), Some(409 * 1_024));
    assert_eq!(pss("Rss: 1 kB\n"), None);
}

#[test]
fn this_process_is_known() {
    assert!(cpu_time(process::id()).is_some());
    assert!(pss_bytes(process::id()).is_none_or(|bytes| bytes > 0));
}
