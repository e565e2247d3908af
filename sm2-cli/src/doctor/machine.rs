//! Checks of the kernel: its version, and its limits.

use std::{fs, io, os::fd::AsFd};

use nix::sys::{
    resource::{Resource, getrlimit},
    utsname::uname,
};
use sm2_io::{SealedLoan, memfd};
use sm2_proto::Seals;

use super::check::Check;

/// The oldest kernel that SM2 runs on: Linux 5.1 added `F_SEAL_FUTURE_WRITE`. A call that
/// later kernels added has a replacement (`epoll_pwait2`, Linux 5.11).
const KERNEL: (u32, u32) = (5, 1);

/// The default of Linux: one datagram of 64 KiB, and the overhead of the kernel.
const SEND_BUFFER_BYTES: u64 = 212_992;

/// The number of datagrams that a socket should hold. A busy node reads several at a time.
const DATAGRAMS: u64 = 10;

/// The descriptors that every process needs.
const BASE_FILES: u64 = 64;

/// The name of the check of open files.
const FILES: &str = "open files";

/// The checks that need no Manager. `nodes` is the number of nodes in the domain if it is known.
pub(super) fn checks(nodes: Option<u64>) -> Vec<Check> {
    vec![
        kernel(),
        files(nodes),
        shared_memory(),
        huge_pages(),
        number(
            "socket buffers",
            "/proc/sys/net/core/wmem_max",
            SEND_BUFFER_BYTES,
            "net.core.wmem_max",
        ),
        number(
            "socket queues",
            "/proc/sys/net/unix/max_dgram_qlen",
            DATAGRAMS,
            "net.unix.max_dgram_qlen",
        ),
    ]
}

fn kernel() -> Check {
    const CHECK: &str = "kernel";
    let release = match uname() {
        Ok(found) => found.release().to_string_lossy().into_owned(),
        Err(errno) => return Check::warn(CHECK, format!("unknown ({errno})"), "see uname -r"),
    };
    match version(&release) {
        Some(found) if found >= KERNEL => Check::ok(CHECK, format!("Linux {release}")),
        found => {
            let (major, minor) = KERNEL;
            let advice = format!("SM2 needs Linux {major}.{minor} or newer");
            match found {
                Some(_) => Check::bad(CHECK, format!("Linux {release}"), advice),
                None => Check::warn(CHECK, format!("Linux {release}"), advice),
            }
        }
    }
}

/// The first two numbers of `6.1.0-13-amd64`.
pub(super) fn version(release: &str) -> Option<(u32, u32)> {
    let mut numbers = release.split(|c: char| !c.is_ascii_digit());
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?))
}

/// Checks the limit of open files. A node needs a descriptor for each link and for each segment, and a
/// Manager needs one for each node.
fn files(nodes: Option<u64>) -> Check {
    let (soft, hard) = match getrlimit(Resource::RLIMIT_NOFILE) {
        Ok(limits) => limits,
        Err(errno) => return Check::warn(FILES, format!("unknown ({errno})"), "see ulimit -n"),
    };
    files_within(soft, hard, nodes)
}

/// Checks these limits of open files.
pub(super) fn files_within(soft: u64, hard: u64, nodes: Option<u64>) -> Check {
    let found = format!("{soft} (at most {hard})");
    // A program that is started from this shell may be linked with every node of the domain.
    let wanted = BASE_FILES + 4 * nodes.unwrap_or(0);
    if hard < wanted {
        let advice = format!("a domain of this size wants {wanted}: raise it in limits.conf");
        return Check::warn(FILES, found, advice);
    }
    if soft < wanted {
        let advice = format!("a domain of this size wants {wanted}: ulimit -n {hard}");
        return Check::warn(FILES, found, advice);
    }
    Check::ok(FILES, found)
}

/// Checks that sealed memfds work. SM2 needs neither `/dev/shm` nor locked memory.
fn shared_memory() -> Check {
    const CHECK: &str = "shared memory";
    let noexec = fs::read_to_string("/proc/sys/vm/memfd_noexec").unwrap_or_default();
    let noexec = match noexec.trim() {
        "" => String::new(),
        value => format!(" (vm.memfd_noexec is {value})"),
    };
    match try_seals() {
        Ok(true) => Check::ok(
            CHECK,
            format!("memfd and seals work{noexec}; /dev/shm and memlock are not needed"),
        ),
        Ok(false) => Check::bad(
            CHECK,
            "a memfd does not keep its seals",
            "is this a sandbox (gVisor, an old container runtime)? run outside of it",
        ),
        Err(error) => {
            let found = format!("{error}{noexec}");
            let advice =
                "memfd_create(2) or F_ADD_SEALS is not allowed here: look at seccomp rules";
            Check::bad(CHECK, found, advice)
        }
    }
}

fn try_seals() -> io::Result<bool> {
    let mut loan = SealedLoan::new(4_096)?;
    loan.as_mut_slice().fill(1);
    let sealed = memfd::facts(loan.seal()?.as_fd())?;
    let pooled = sm2_io::CounterPage::new()?;
    let pooled = memfd::facts(pooled.as_fd())?;
    Ok(sealed.seals.contains(Seals::SEALED) && pooled.seals.contains(Seals::POOLED))
}

fn huge_pages() -> Check {
    const CHECK: &str = "huge pages";
    const PATH: &str = "/sys/kernel/mm/transparent_hugepage/shmem_enabled";
    let advice = format!("large sealed messages cost less with: echo advise > {PATH}");
    match fs::read_to_string(PATH) {
        Err(error) => Check::warn(CHECK, format!("{PATH}: {error}"), "this kernel has none"),
        Ok(setting) => {
            let chosen = setting.split(['[', ']']).nth(1).unwrap_or(setting.trim());
            let found = format!("shmem_enabled is {chosen}");
            match memfd::huge_pages_allowed_by(&setting) {
                true => Check::ok(CHECK, found),
                false => Check::warn(CHECK, found, advice),
            }
        }
    }
}

fn number(check: &'static str, path: &str, least: u64, name: &str) -> Check {
    let found = fs::read_to_string(path).ok();
    match found.and_then(|text| text.trim().parse::<u64>().ok()) {
        Some(value) if value >= least => Check::ok(check, format!("{name} is {value}")),
        Some(value) => Check::warn(
            check,
            format!("{name} is {value}"),
            format!("sysctl -w {name}={least}"),
        ),
        // A container may hide the file. The limit of the host applies then.
        None => Check::ok(check, format!("{name} cannot be read here")),
    }
}
