//! The processor time and memory of a process, and the available memory of the machine.

use std::time::Duration;

use procfs::{Current, Meminfo, process::Process};

/// The processor time that all threads of process `pid` have used; `None` if the process is gone.
pub(crate) fn cpu_time(pid: u32) -> Option<Duration> {
    let stat = process(pid)?.stat().ok()?;
    let ticks = stat.utime.checked_add(stat.stime)?;
    Some(Duration::from_millis(
        ticks * 1_000 / procfs::ticks_per_second(),
    ))
}

/// The proportional set size of process `pid` in bytes: memory that several processes map is divided
/// among them. `None` if the process is gone, or if this user may not read it.
pub(crate) fn pss_bytes(pid: u32) -> Option<u64> {
    let maps = process(pid)?.smaps_rollup().ok()?.memory_map_rollup;
    maps.0.first()?.extension.map.get("Pss").copied()
}

/// The memory that is available without swapping, in bytes.
pub(crate) fn available_bytes() -> Option<u64> {
    Meminfo::current().ok()?.mem_available
}

fn process(pid: u32) -> Option<Process> {
    Process::new(i32::try_from(pid).ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_is_known() {
        let pid = std::process::id();
        assert!(cpu_time(pid).is_some());
        assert!(pss_bytes(pid).is_none_or(|bytes| bytes > 0));
        assert!(available_bytes().is_some_and(|bytes| bytes > 0));
    }

    #[test]
    fn a_process_that_is_gone_costs_nothing() {
        // The kernel's largest process number is 2^22.
        assert_eq!(cpu_time(u32::MAX / 2), None);
        assert_eq!(pss_bytes(u32::MAX / 2), None);
    }
}
