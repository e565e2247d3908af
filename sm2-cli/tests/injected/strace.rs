//! Runs programs under `strace`, which counts their system calls or makes one of them fail.

use std::{collections::BTreeMap, fmt, fs, process::Command};

use sm2_tests::process::Process;
use tempfile::NamedTempFile;

/// The errors that the kernel can report for a call although its arguments are right.
///
/// The list has no `write`: most of these calls wake a thread by an eventfd, which cannot fail, so tokio panics if it
/// does. `tests/cli/wrong.rs` writes to a full disk. Nor has the list `sendto`: handlers of signals wake threads by it,
/// and cannot try again.
const ERRNOS: [(&str, &[&str]); 30] = [
    ("accept4", &["EMFILE", "ENOMEM", "ECONNABORTED", "EINTR"]),
    ("bind", &["EACCES", "ENOMEM", "ENOSPC"]),
    ("clone3", &["EAGAIN"]),
    ("connect", &["ECONNREFUSED", "EAGAIN"]),
    ("epoll_create1", &["EMFILE", "ENFILE", "ENOMEM"]),
    ("epoll_ctl", &["ENOMEM", "ENOSPC"]),
    ("epoll_pwait2", &["EINTR", "ENOMEM"]),
    ("epoll_wait", &["EINTR"]),
    ("eventfd2", &["EMFILE", "ENOMEM"]),
    ("fallocate", &["ENOSPC", "ENOMEM"]),
    ("fcntl", &["EMFILE", "ENOMEM"]),
    ("flock", &["EINTR", "ENOLCK"]),
    ("ftruncate", &["ENOSPC", "EINTR"]),
    ("getsockopt", &["ENOMEM"]),
    ("listen", &["ENOMEM"]),
    ("memfd_create", &["EMFILE", "ENOMEM"]),
    ("mkdir", &["EACCES", "ENOSPC"]),
    ("mmap", &["ENOMEM"]),
    ("openat", &["EMFILE", "ENFILE", "EACCES"]),
    ("ppoll", &["EINTR", "ENOMEM"]),
    ("read", &["EINTR"]),
    ("recvmmsg", &["ENOMEM", "EINTR"]),
    ("recvmsg", &["ENOMEM", "ENOBUFS", "EINTR"]),
    ("rename", &["EACCES", "ENOSPC"]),
    ("sendmsg", &["ENOMEM", "ENOBUFS", "EINTR", "ETOOMANYREFS"]),
    ("setsockopt", &["ENOMEM"]),
    ("socket", &["EMFILE", "ENFILE", "ENOMEM"]),
    ("socketpair", &["EMFILE", "ENFILE", "ENOMEM"]),
    ("timerfd_create", &["EMFILE", "ENOMEM"]),
    ("unlink", &["EACCES"]),
];

/// The standard library makes this call before `main`, and no earlier one is a call of SM2.
const BEFORE_MAIN: &str = "sigaltstack({ss_sp=";

/// A call that has to fail.
#[derive(Clone, Debug)]
pub(crate) struct Fault {
    call: String,
    /// The call of a thread that fails, counted from 1.
    nth: u64,
    errno: String,
}

impl Fault {
    /// Parses `CALL:NTH:ERRNO`, with the names that strace uses.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let [call, nth, errno] = text.split(':').collect::<Vec<_>>().try_into().ok()?;
        Some(Self {
            call: call.to_owned(),
            nth: nth.parse().ok()?,
            errno: errno.to_owned(),
        })
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { call, nth, errno } = self;
        write!(f, "{call}:{nth}:{errno}")
    }
}

/// The first fault of each call.
pub(crate) fn first_of_each(faults: Vec<Fault>) -> Vec<Fault> {
    let mut faults = faults;
    faults.dedup_by(|a, b| a.call == b.call);
    faults
}

/// The program of a scenario whose calls are counted or fail: the options of `strace` for it, if there are any.
#[derive(Clone, Debug, Default)]
pub(crate) struct Victim(Vec<String>);

/// The calls of a victim.
pub(crate) struct Log(NamedTempFile);

impl Victim {
    /// A program without a fault.
    pub(crate) const NONE: Self = Self(Vec::new());

    /// A program whose calls are counted.
    pub(crate) fn counted() -> (Self, Log) {
        let file = NamedTempFile::new().expect("a file");
        let calls = ERRNOS.map(|(call, _)| call).join(",");
        let options = [
            format!("--output={}", file.path().display()),
            // `?` is for calls that this processor does not have.
            format!("--trace=sigaltstack,?{}", calls.replace(',', ",?")),
        ];
        (Self(options.into()), Log(file))
    }

    /// A program with a fault.
    pub(crate) fn injected(Fault { call, nth, errno }: &Fault) -> Self {
        let options = [
            "--output=/dev/null".to_owned(),
            format!("--trace={call}"),
            format!("--inject={call}:error={errno}:when={nth}"),
        ];
        Self(options.into())
    }

    /// Whether this call of the program fails once.
    pub(crate) fn fails(&self, call: &str) -> bool {
        self.0.contains(&format!("--trace={call}"))
    }

    /// Starts a program, under `strace` if this is a victim.
    pub(crate) fn start(&self, command: Command) -> Process {
        Process::start(self.wrap(command))
    }

    fn wrap(&self, command: Command) -> Command {
        if self.0.is_empty() {
            return command;
        }
        let mut traced = Command::new("strace");
        // The program is the child of the test, and strace its grandchild: signals go to the program.
        traced.args(["--daemonize", "--follow-forks", "--seccomp-bpf", "-qq"]);
        traced.args(&self.0);
        traced.arg(command.get_program()).args(command.get_args());
        for (name, value) in command.get_envs() {
            match value {
                Some(value) => traced.env(name, value),
                None => traced.env_remove(name),
            };
        }
        traced
    }
}

/// Whether `strace` can inject errors here.
pub(crate) fn is_available() -> Result<(), String> {
    let fault = Fault::parse("uname:1:EPERM").expect("a fault");
    let output = Victim::injected(&fault)
        .wrap(Command::new("uname"))
        .output();
    let output = output.map_err(|error| format!("strace: {error}"))?;
    let text = String::from_utf8_lossy(&output.stderr);
    match text.starts_with("uname: ") {
        true => Ok(()),
        false => Err(format!("strace injects no errors here: {text}")),
    }
}

impl Log {
    /// All single faults of the counted calls from the start of `main` on.
    pub(crate) fn faults(&self) -> Vec<Fault> {
        let text = fs::read_to_string(self.0.path()).expect("the log of strace");
        let Counts { before, threads } = Counts::of(&text);
        let mut faults = Vec::new();
        for (call, errnos) in ERRNOS {
            let counts = threads.iter().filter(|((_, it), _)| *it == call);
            let most = counts.map(|(_, count)| *count).max().unwrap_or(0);
            let first = before.get(call).copied().unwrap_or(0) + 1;
            for errno in errnos {
                faults.extend((first..=most).map(|nth| Fault {
                    call: call.to_owned(),
                    nth,
                    errno: (*errno).to_owned(),
                }));
            }
        }
        faults
    }
}

/// How often each call was made.
struct Counts<'a> {
    /// Before `main`.
    before: BTreeMap<&'a str, u64>,
    /// By each thread.
    threads: BTreeMap<(&'a str, &'a str), u64>,
}

impl<'a> Counts<'a> {
    fn of(log: &'a str) -> Self {
        let (mut before, mut threads) = (BTreeMap::new(), BTreeMap::new());
        let mut is_before = true;
        for line in log.lines() {
            let Some((thread, rest)) = line.split_once(' ') else {
                continue;
            };
            let rest = rest.trim_start();
            is_before &= !rest.starts_with(BEFORE_MAIN);
            // Other lines are `<... call resumed>`, signals and the ends of threads.
            let Some((call, _)) = rest.split_once('(').filter(|(it, _)| is_call(it)) else {
                continue;
            };
            *threads.entry((thread, call)).or_default() += 1;
            if is_before {
                *before.entry(call).or_default() += 1;
            }
        }
        assert!(!is_before, "strace has seen no main");
        Self { before, threads }
    }
}

fn is_call(text: &str) -> bool {
    text.bytes()
        .all(|it| it.is_ascii_alphanumeric() || it == b'_')
}
