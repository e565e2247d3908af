//! A node in a container. It has separate namespaces for mounts, processes, IPC, network and host
//! name, its own file system, and one read-only folder of the host: the folder of the socket.
//! `packaging/containers.md` describes the same setup for users.

use std::{fs, path::Path, process::Command};

use nix::unistd::geteuid;
use sm2_proto::control::Item;
use sm2_test_support::{skip, skip_without};
use sm2_tests::{actor::Actor, domain::TempDomain, process::actor, raw::RawNode};

/// The steps of a container runtime. `$1` is the new root (an empty folder), `$2` the folder of the
/// socket, `$3` the program; the rest are the program's arguments.
const CONTAINER: &str = r#"
set -e
root=$1 domain=$2 program=$3
shift 3
mount --make-rprivate /
mount -t tmpfs tmpfs "$root"
mkdir -p "$root/run/sm2" "$root/tmp" "$root/proc" "$root/old"
mount -t proc proc "$root/proc"
for folder in usr bin lib lib64; do
    if [ -L "/$folder" ]; then
        cp -P "/$folder" "$root/$folder"
    elif [ -d "/$folder" ]; then
        mkdir "$root/$folder"
        mount --rbind "/$folder" "$root/$folder"
    fi
done
touch "$root/program"
mount --bind "$program" "$root/program"
mount --bind "$domain" "$root/run/sm2"
mount -o remount,bind,ro "$root/run/sm2"
cd "$root"
pivot_root . old
umount -l /old
exec /program "$@"
"#;

/// `unshare` with new namespaces of all kinds.
fn unshare() -> Command {
    let mut command = Command::new("unshare");
    if !geteuid().is_root() {
        command.args(["--user", "--map-root-user"]);
    }
    command.args(["--mount", "--pid", "--ipc", "--net", "--uts"]);
    command.args(["--fork", "--kill-child"]);
    command
}

/// True if the kernel and the user of this test allow containers.
fn is_possible() -> bool {
    let tried = unshare()
        .args(["mount", "-t", "proc", "proc", "/proc"])
        .output();
    let why = match tried {
        Ok(output) if output.status.success() => return true,
        Ok(output) => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
        Err(error) => {
            skip_without("unshare", error);
            return false;
        }
    };
    skip(format_args!("namespaces cannot be made here: {why}"));
    false
}

/// A role of the actor in a container. `root` is an empty folder, and stays empty outside of the
/// container.
fn contained(root: &Path, domain: &TempDomain, role: &str) -> Command {
    // Started like every other actor, so that it has the same environment.
    let outside = actor(role);
    let mut command = unshare();
    command.args(["sh", "-c", CONTAINER, "sh"]);
    command.arg(root).arg(domain.folder());
    command.arg(outside.get_program()).args(outside.get_args());
    for (variable, _) in outside.get_envs() {
        command.env_remove(variable);
    }
    command
}

/// Exchanges messages of all forms: in the datagram, and in shared memory.
fn exchange(from: &mut Actor, to: &mut Actor, topic: &str) {
    from.tell(&format!("pub out-{topic} {topic} reliable_ms=60000"));
    to.tell(&format!("sub in-{topic} {topic} reliable"));
    from.tell(&format!("wait out-{topic} 1"));
    for size in [0, 8, 5_000, 3_000_000, 10_000_000] {
        from.tell(&format!("publish out-{topic} 1 {size}"));
        let taken = to.tell(&format!("take in-{topic} 1"));
        assert!(taken.ends_with("lost=0 damaged=0"), "{size}: {taken}");
    }
}

//= SM2-TRN-001, SM2-TRN-006 sys
#[test]
fn a_container_needs_the_folder_of_the_socket_and_nothing_else() {
    if !is_possible() {
        return;
    }
    let domain = TempDomain::new();
    let mut manager = domain.manager();
    let root = tempfile::tempdir().expect("a temporary folder");
    let path = Path::new("/run/sm2/domain.sock");
    let mut outside = Actor::start(&domain.socket(), "outside");
    let command = contained(root.path(), &domain, "node");
    let mut inside = Actor::start_as(command, path, "inside");
    exchange(&mut outside, &mut inside, "inwards");
    exchange(&mut inside, &mut outside, "outwards");

    // The Manager sees the container's process by its number on the host.
    let observer = RawNode::welcomed(&domain.socket(), "observer");
    let pid = observer
        .query_all()
        .into_iter()
        .find_map(|item| match item {
            Item::Node { name, pid, uid, .. } if name.as_str() == "inside" => {
                assert_eq!(uid, geteuid().as_raw());
                Some(pid)
            }
            _ => None,
        });
    let pid = pid.expect("the node in the container");
    for kind in ["mnt", "pid", "ipc", "net", "uts"] {
        let namespace = |process: &str| fs::read_link(format!("/proc/{process}/ns/{kind}"));
        let theirs = namespace(&pid.to_string()).expect("its namespace");
        let ours = namespace("self").expect("ours");
        assert_ne!(theirs, ours, "{kind}");
    }

    // The folder is mounted, not the socket, so the socket of the next Manager is visible inside,
    // too.
    manager.kill();
    let _next = domain.manager();
    let root = tempfile::tempdir().expect("a temporary folder");
    let command = contained(root.path(), &domain, "node");
    let mut another = Actor::start_as(command, path, "another");
    exchange(&mut another, &mut inside, "between");
}
