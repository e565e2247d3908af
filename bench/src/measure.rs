//! Measurements of other processes by the kernel.

use std::{fs, io};

use nix::{
    time::{clock_getcpuclockid, clock_gettime},
    unistd::Pid,
};

/// The CPU time of all threads of a process so far, in nanoseconds.
///
/// # Errors
///
/// The process has ended.
pub fn cpu_ns(pid: Pid) -> io::Result<u64> {
    let clock = clock_getcpuclockid(pid)?;
    let time = clock_gettime(clock)?;
    Ok(std::time::Duration::from(time).as_nanos() as u64)
}

/// The proportional set size (PSS) of a process, in bytes: memory that several processes share
/// counts in equal parts.
///
/// # Errors
///
/// The process has ended, or belongs to another user.
pub fn pss_bytes(pid: Pid) -> io::Result<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/smaps_rollup"))?;
    let pss = number_after(&text, "Pss:").ok_or(io::ErrorKind::InvalidData)?;
    Ok(pss * 1_024)
}

/// The peak of the resident memory of this process so far, in bytes.
///
/// # Errors
///
/// The kernel does not tell.
pub fn peak_bytes() -> io::Result<u64> {
    let text = fs::read_to_string("/proc/self/status")?;
    let peak = number_after(&text, "VmHWM:").ok_or(io::ErrorKind::InvalidData)?;
    Ok(peak * 1_024)
}

/// The bytes that this process has fetched from disks so far.
///
/// # Errors
///
/// The kernel does not tell.
pub fn fetched_bytes() -> io::Result<u64> {
    let text = fs::read_to_string("/proc/self/io")?;
    let fetched = number_after(&text, "read_bytes:");
    Ok(fetched.ok_or(io::ErrorKind::InvalidData)?)
}

/// The number of voluntary context switches of all threads of a process so far: the number of times
/// that they went to sleep.
///
/// # Errors
///
/// The process has ended.
pub fn sleeps(pid: Pid) -> io::Result<u64> {
    let mut sum = 0;
    for task in fs::read_dir(format!("/proc/{pid}/task"))? {
        // A thread that has just ended is not counted.
        let Ok(text) = fs::read_to_string(task?.path().join("status")) else {
            continue;
        };
        sum += number_after(&text, "voluntary_ctxt_switches:").unwrap_or(0);
    }
    Ok(sum)
}

/// The number in the line that starts with this name.
fn number_after(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::{cpu_ns, fetched_bytes, number_after, peak_bytes, pss_bytes, sleeps};
    use nix::unistd::Pid;

    #[test]
    fn a_line_is_found_by_its_whole_name() {
        let text = "nonvoluntary_ctxt_switches:\t9\nvoluntary_ctxt_switches:\t4\nPss:  12 kB\n";
        assert_eq!(number_after(text, "voluntary_ctxt_switches:"), Some(4));
        assert_eq!(number_after(text, "Pss:"), Some(12));
        assert_eq!(number_after(text, "Rss:"), None);
    }

    #[test]
    fn a_process_knows_itself() {
        let me = Pid::this();
        assert!(pss_bytes(me).unwrap() > 100_000);
        assert!(cpu_ns(me).unwrap() > 0);
        assert!(sleeps(me).is_ok());
        assert!(peak_bytes().unwrap() >= pss_bytes(me).unwrap() / 2);
        assert!(fetched_bytes().is_ok());
    }

    #[test]
    fn nobody_is_measured_who_is_not_there() {
        // Larger than the kernel's greatest process number.
        let nobody = Pid::from_raw(1 << 23);
        assert!(cpu_ns(nobody).is_err());
        assert!(pss_bytes(nobody).is_err());
        assert!(sleeps(nobody).is_err());
    }
}
