//! A Manager and nodes without a network, without rights, without files to write, and as other
//! users: as the units in `packaging/systemd` and container runtimes confine them. Gateways have a network in
//! addition.
//!
//! `bwrap` confines a process: a read-only file system, an empty network namespace, and a filter of
//! system calls that permits `socket` for `AF_UNIX` alone, as `RestrictAddressFamilies=AF_UNIX`. A gateway has the
//! network of this process, and its filter permits `AF_INET` and `AF_INET6` as well.

use std::{
    fs::{self, Permissions},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::Command,
};

use nix::{
    libc::{AF_INET, AF_INET6, AF_UNIX, EAFNOSUPPORT, SYS_socket, c_int},
    unistd::{Uid, chown, geteuid},
};
use sm2_gateway::keys;
use sm2_proto::gateway::GatewayId;
use sm2_test_support::{skip, skip_without};
use sm2_tests::{
    actor::Actor,
    domain::TempDomain,
    process::{Process, actor},
};

const USER: u32 = 65_534;
const OTHER_USER: u32 = 65_533;

/// The number of the processor in the kernel's filters, `AUDIT_ARCH_…`.
#[cfg(target_arch = "x86_64")]
const AUDIT_ARCH: u32 = 0xc000_003e;
#[cfg(target_arch = "aarch64")]
const AUDIT_ARCH: u32 = 0xc000_00b7;
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
const AUDIT_ARCH: u32 = 0;

/// A part of this machine that a confined process may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Network {
    /// For Managers and nodes.
    None,
    /// For gateways.
    Internet,
}

impl Network {
    /// The families of sockets that the filter permits.
    const fn families(self) -> &'static [c_int] {
        match self {
            Self::None => &[AF_UNIX],
            Self::Internet => &[AF_UNIX, AF_INET, AF_INET6],
        }
    }
}

/// A filter in the kernel's format: it refuses `socket` with EAFNOSUPPORT for every other family.
fn filter(families: &[c_int]) -> Vec<u8> {
    // Codes of classic BPF: load a word, jump if equal, return.
    const LOAD: u16 = 0x20;
    const JUMP: u16 = 0x15;
    const RETURN: u16 = 0x06;
    const ALLOW: u32 = 0x7fff_0000;
    const ERRNO: u32 = 0x0005_0000;
    const KILL: u32 = 0x8000_0000;
    // Offsets in `struct seccomp_data`: the number of the call, the processor, the first argument.
    let (number, arch, family) = (0, 4, 16);
    let socket = u32::try_from(SYS_socket).expect("a small number");
    let count = u8::try_from(families.len()).expect("a small number");
    let mut program: Vec<(u16, u8, u8, u32)> = vec![
        (LOAD, 0, 0, arch),
        (JUMP, 1, 0, AUDIT_ARCH),
        (RETURN, 0, 0, KILL),
        (LOAD, 0, 0, number),
        (JUMP, 0, 2 + count, socket),
        (LOAD, 0, 0, family),
    ];
    for (left, permitted) in (1..=count).rev().zip(families) {
        program.push((JUMP, left, 0, permitted.cast_unsigned()));
    }
    program.push((RETURN, 0, 0, ERRNO | EAFNOSUPPORT.cast_unsigned()));
    program.push((RETURN, 0, 0, ALLOW));
    let bytes = program.into_iter().flat_map(|(code, yes, no, value)| {
        let code = code.to_ne_bytes();
        let value = value.to_ne_bytes();
        [&code[..], &[yes, no], &value[..]].concat()
    });
    bytes.collect()
}

/// A folder with a domain, the filters, and a copy of the program that every user may execute.
struct Confinement {
    domain: TempDomain,
    program: PathBuf,
}

impl Confinement {
    /// `None` if processes cannot be confined here; reports the reason.
    fn new() -> Option<Self> {
        let domain = TempDomain::new();
        let program = domain.folder().join("actor");
        for network in [Network::None, Network::Internet] {
            let path = filter_path(&domain, network);
            fs::write(path, filter(network.families())).expect("a file");
        }
        fs::set_permissions(domain.folder(), Permissions::from_mode(0o711)).expect("chmod");
        // Copied by another process, so that no child of this one holds it open for writing.
        let mut copy = Command::new("cp");
        copy.arg(actor("probe").get_program()).arg(&program);
        assert!(copy.status().expect("cp").success());
        let confinement = Self { domain, program };
        let why = if !geteuid().is_root() {
            "only root can start processes of other users".to_owned()
        } else if AUDIT_ARCH == 0 {
            "the filter is for other processors".to_owned()
        } else {
            match confinement.probe(Network::None).output() {
                Ok(output) if output.status.success() => return Some(confinement),
                Ok(output) => {
                    skip_without("bwrap", String::from_utf8_lossy(&output.stderr));
                    return None;
                }
                Err(error) => error.to_string(),
            }
        };
        skip(why);
        None
    }

    /// The command that runs the program as this user with this network, and lets it write in at most this folder.
    fn wrap(&self, user: u32, network: Network, writable: Option<&Path>) -> Command {
        let mut command = Command::new("sh");
        // bwrap reads the filter from descriptor 9.
        command.args(["-c", r#"exec 9<"$0" && exec "$@""#]);
        command.arg(filter_path(&self.domain, network));
        command.args([
            "bwrap",
            "--die-with-parent",
            "--ro-bind",
            "/",
            "/",
            "--dev",
            "/dev",
        ]);
        if let Some(folder) = writable {
            command.arg("--bind").args([folder, folder]);
        }
        if network == Network::None {
            command.arg("--unshare-net");
        }
        command.args(["--unshare-ipc", "--seccomp", "9"]);
        // For setpriv, which then gives up all rights.
        command.args(["--cap-add", "CAP_SETUID", "--cap-add", "CAP_SETGID", "--"]);
        let user = user.to_string();
        command.args([
            "setpriv",
            "--reuid",
            &user,
            "--regid",
            &user,
            "--clear-groups",
        ]);
        command.args(["--no-new-privs", "--inh-caps=-all"]);
        command.arg(&self.program);
        command
    }

    fn node(&self, user: u32, name: &str) -> Actor {
        let mut command = self.wrap(user, Network::None, None);
        command.arg("node");
        Actor::start_as(command, &self.domain.socket(), name)
    }

    fn manager(&self) -> Process {
        let folder = self.domain.folder();
        chown(folder, Some(Uid::from_raw(USER)), None).expect("chown of the folder");
        let mut command = self.wrap(USER, Network::None, Some(folder));
        command
            .arg("manager")
            .arg("--socket")
            .arg(self.domain.socket());
        command.args(["--socket-mode", "666"]);
        let manager = Process::start(command);
        manager.stderr_says("serving");
        manager
    }

    /// A gateway that carries everything to and from a peer. It knows the address of the peer, if that is given.
    fn gateway(&self, (name, id): (&str, GatewayId), address: Option<&str>) -> Process {
        let folder = self.domain.folder();
        let addresses = address.map_or_else(String::new, |it| format!("addresses = [\"{it}\"]\n"));
        let text = format!(
            "name = \"here\"\nlisten = \"127.0.0.1:0\"\nkey = \"key\"\nsocket = \"domain.sock\"\n\
             [[peer]]\nname = \"{name}\"\nid = \"{id}\"\n{addresses}\
             [[rule]]\naction = \"allow\"\nnames = \"**\"\n"
        );
        let config = folder.join("gateway.toml");
        fs::write(&config, text).expect("a file");
        let user = Some(Uid::from_raw(OTHER_USER));
        chown(&folder.join("key"), user, None).expect("chown of the key");
        let mut command = self.wrap(OTHER_USER, Network::Internet, None);
        command.arg("gateway").arg("--config").arg(config);
        Process::start(command)
    }

    /// Makes the key of the gateway of this domain.
    fn key(&self) -> GatewayId {
        keys::generate(&self.domain.folder().join("key"))
            .expect("a key")
            .id()
    }

    /// A process that tries what must not be possible.
    fn probe(&self, network: Network) -> Command {
        let mut command = self.wrap(USER, network, None);
        command.args(["probe", "--write"]);
        command.arg(self.domain.folder().join("written"));
        command
    }
}

fn filter_path(domain: &TempDomain, network: Network) -> PathBuf {
    domain.folder().join(format!("{network:?}.filter"))
}

fn report(mut command: Command) -> String {
    let output = command.output().expect("a probe");
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

/// The other tests rely on the confinement, so it is tested as well.
#[test]
fn the_confinement_confines() {
    let Some(confinement) = Confinement::new() else {
        return;
    };
    assert_eq!(
        report(confinement.probe(Network::None)),
        "unix=ok inet=EAFNOSUPPORT inet6=EAFNOSUPPORT netlink=EAFNOSUPPORT write=EROFS devices=1 uid=65534"
    );
    let internet = report(confinement.probe(Network::Internet));
    let expected = "unix=ok inet=ok inet6=ok netlink=EAFNOSUPPORT write=EROFS";
    assert!(internet.starts_with(expected), "{internet}");
    let mut free = actor("probe");
    free.arg("--write")
        .arg(confinement.domain.folder().join("free"));
    let free = report(free);
    assert!(
        free.contains("unix=ok inet=ok") && free.contains("write=ok"),
        "{free}"
    );
}

/// Messages of all forms and calls work between confined processes of one user and of two.
//= SM2-TRN-001 sys
#[test]
fn a_manager_and_nodes_need_no_network_no_rights_and_no_files_to_write() {
    let Some(confinement) = Confinement::new() else {
        return;
    };
    let _manager = confinement.manager();
    let mut talker = confinement.node(USER, "talker");
    let mut friend = confinement.node(USER, "friend");
    let mut stranger = confinement.node(OTHER_USER, "stranger");
    talker.tell("pub t t reliable_ms=60000");
    for listener in [&mut friend, &mut stranger] {
        listener.tell("sub t t reliable");
    }
    talker.tell("wait t 2");
    for size in [8, 5_000, 3_000_000] {
        talker.tell(&format!("publish t 1 {size}"));
        for listener in [&mut friend, &mut stranger] {
            let taken = listener.tell("take t 1");
            assert!(taken.ends_with("lost=0 damaged=0"), "{size}: {taken}");
        }
    }
    stranger.tell("server s s");
    talker.tell("client s s");
    talker.tell("wait s 1");
    talker.tell("call s 70000");
    stranger.tell("accept s");
    stranger.tell("answer s");
    talker.tell("reply s");
}

/// Two gateways with a network and no other rights carry messages and calls between two domains.
#[test]
fn gateways_need_a_network_but_no_rights_and_no_files_to_write() {
    let (Some(near), Some(far)) = (Confinement::new(), Confinement::new()) else {
        return;
    };
    let _managers = [near.manager(), far.manager()];
    let (near_id, far_id) = (near.key(), far.key());
    let far_gateway = far.gateway(("near", near_id), None);
    let address = far_gateway.expect_line();
    let near_gateway = near.gateway(("far", far_id), Some(&address));
    near_gateway.expect_line();
    let mut talker = near.node(USER, "talker");
    let mut listener = far.node(USER, "listener");
    talker.tell("pub t t");
    listener.tell("sub t t");
    talker.tell("wait t 1");
    // The publisher of the far gateway.
    listener.tell("wait t 1");
    for size in [8, 5_000, 3_000_000] {
        talker.tell(&format!("publish t 1 {size}"));
        let taken = listener.tell("take t 1");
        assert!(taken.ends_with("lost=0 damaged=0"), "{size}: {taken}");
    }
    listener.tell("server s s");
    talker.tell("client s s");
    talker.tell("wait s 1");
    talker.tell("call s 70000");
    listener.tell("accept s");
    listener.tell("answer s");
    talker.tell("reply s");
}
