//! The processes of nodes, as `/proc` shows them.

use std::{collections::HashMap, fs, os::unix::fs::MetadataExt, time::Duration};

use nix::unistd::{SysconfVar, sysconf};
use sm2_io::clock;
use sm2_proto::{Instant, domain::NodeView};

/// The position of the time in user mode among the fields after the name. The time in kernel mode follows.
const USER_TIME: usize = 11;

/// The fields of `/proc/PID/stat` of a node's process, from its state on. `None` if this program cannot see the
/// process: the Manager may have another process namespace.
pub(crate) fn stat(node: &NodeView<'_>) -> Option<String> {
    let folder = format!("/proc/{}", node.pid);
    // In another namespace the number could belong to somebody else's process.
    let owner = fs::metadata(&folder).ok()?.uid();
    let stat = fs::read_to_string(format!("{folder}/stat")).ok()?;
    (owner == node.uid).then(|| fields(&stat).map(str::to_owned))?
}

/// The part of a line of `/proc/PID/stat` after the name: `77 (na me) S 1 …`. The name may contain anything.
fn fields(stat: &str) -> Option<&str> {
    let (_, fields) = stat.rsplit_once(')')?;
    Some(fields.trim_start())
}

/// The processor time that a process has used so far.
fn processor_time(stat: &str, ticks_per_s: u64) -> Option<Duration> {
    let mut fields = stat.split(' ').skip(USER_TIME);
    let mut ticks = || fields.next()?.parse::<u64>().ok();
    let ticks = ticks()?.saturating_add(ticks()?);
    // In milliseconds: a tick is 10 ms nearly everywhere.
    let ms = ticks.saturating_mul(1_000).checked_div(ticks_per_s)?;
    Some(Duration::from_millis(ms))
}

/// The share of a processor that each process of some nodes uses.
#[derive(Debug, Default)]
pub(crate) struct ProcessorUse {
    at: Option<Instant>,
    /// The time that each process had used at the last look.
    used: HashMap<i32, Duration>,
    percent: HashMap<i32, f64>,
}

impl ProcessorUse {
    /// Reads the times of the processes of these nodes. The shares are those since the last look.
    pub(crate) fn look<'n>(&mut self, nodes: impl Iterator<Item = NodeView<'n>>) {
        let ticks_per_s = sysconf(SysconfVar::CLK_TCK).ok().flatten();
        let ticks_per_s = ticks_per_s.map_or(0, i64::cast_unsigned);
        let mut used = HashMap::new();
        for node in nodes {
            let time = stat(&node).and_then(|stat| processor_time(&stat, ticks_per_s));
            used.extend(time.map(|time| (node.pid, time)));
        }
        let now = clock::now();
        let elapsed = self.at.map_or(Duration::ZERO, |at| now.since(at));
        self.percent = shares(&self.used, &used, elapsed);
        (self.at, self.used) = (Some(now), used);
    }

    /// The share of one processor that the process used, in percent. `None` if it is not known.
    pub(crate) fn percent(&self, pid: i32) -> Option<f64> {
        self.percent.get(&pid).copied()
    }
}

fn shares(
    before: &HashMap<i32, Duration>,
    now: &HashMap<i32, Duration>,
    elapsed: Duration,
) -> HashMap<i32, f64> {
    let share = |(pid, time): (&i32, &Duration)| {
        // The number may have passed to a younger process.
        let more = time.checked_sub(*before.get(pid)?)?;
        Some((*pid, 100.0 * more.as_secs_f64() / elapsed.as_secs_f64()))
    };
    match elapsed.is_zero() {
        true => HashMap::new(),
        false => now.iter().filter_map(share).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fields_follow_any_name() {
        assert_eq!(fields("77 (a) T (b) S 1 77"), Some("S 1 77"));
        assert_eq!(fields("77 (a"), None);
    }

    #[test]
    fn the_processor_time_is_that_of_both_modes() {
        let stat = "S 1 77 77 0 -1 4194560 100 0 0 0 150 50 3 4 20 0 1 0";
        assert_eq!(processor_time(stat, 100), Some(Duration::from_secs(2)));
        assert_eq!(processor_time(stat, 0), None);
        assert_eq!(processor_time("S 1 77", 100), None);
    }

    #[test]
    fn a_share_is_that_of_the_elapsed_time() {
        let times = |list: &[(i32, u64)]| {
            let times = list
                .iter()
                .map(|&(pid, ms)| (pid, Duration::from_millis(ms)));
            times.collect::<HashMap<_, _>>()
        };
        let before = times(&[(1, 1_000), (2, 500), (3, 900)]);
        // Process 3 is another one by now.
        let now = times(&[(1, 1_250), (2, 500), (3, 10), (4, 10)]);
        let shares = shares(&before, &now, Duration::from_millis(500));
        assert_eq!(shares, HashMap::from([(1, 50.0), (2, 0.0)]));
        assert!(super::shares(&before, &now, Duration::ZERO).is_empty());
    }
}
