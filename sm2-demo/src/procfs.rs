//! What a process costs, as `/proc` says.

use std::{fs, time::Duration};

use nix::unistd::{SysconfVar, sysconf};

/// Processor time that process `pid` has used so far, of all its threads; none when it is gone.
pub(crate) fn cpu_time(pid: u32) -> Option<Duration> {
    let ticks = ticks(&fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)?;
    let per_second = u64::try_from(sysconf(SysconfVar::CLK_TCK).ok()??).ok()?;
    Some(Duration::from_millis(ticks * 1_000 / per_second))
}

/// The process' share of the memory that it maps, in bytes: what several processes map is divided
/// among them. None when it is gone, or this user may not know.
pub(crate) fn pss_bytes(pid: u32) -> Option<u64> {
    pss(&fs::read_to_string(format!("/proc/{pid}/smaps_rollup")).ok()?)
}

/// Memory that can be had without swapping, in bytes.
pub(crate) fn available_bytes() -> Option<u64> {
    kib_of(&fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:")
}

/// `utime` and `stime` of proc_pid_stat(5), fields 14 and 15. Field 2, the program's name, may
/// hold spaces and parentheses: what follows its last parenthesis starts with field 3.
fn ticks(stat: &str) -> Option<u64> {
    let (_, fields) = stat.rsplit_once(") ")?;
    let mut times = fields.split(' ').skip(11).map(str::parse);
    let user: u64 = times.next()?.ok()?;
    let system: u64 = times.next()?.ok()?;
    user.checked_add(system)
}

fn pss(rollup: &str) -> Option<u64> {
    kib_of(rollup, "Pss:")
}

/// The value of a line such as `Pss:  12 kB`, in bytes.
fn kib_of(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kib: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    kib.checked_mul(1_024)
}

#[cfg(test)]
mod tests;
