//! Completions and manual pages.

use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    process::{Command, Stdio},
};

use nix::sys::signal::Signal;
use sm2_test_support::skip_without;

use crate::common::{Domain, Finished, Running, files, sm2};

fn run(arguments: &[&str]) -> Finished {
    Running::start(&mut sm2(arguments)).finish()
}

/// The answers of a shell's completion of the last word.
fn complete_at(socket: &Path, words: &[&str]) -> BTreeSet<String> {
    let mut command = sm2(&["--", "sm2"]);
    command.args(words).env("COMPLETE", "bash");
    command.env("_CLAP_COMPLETE_INDEX", words.len().to_string());
    command.env("SM2_SOCKET", socket);
    let finished = Running::start(&mut command).finish();
    // Any text would stand in the middle of the person's command line.
    assert_eq!((finished.code(), finished.stderr()), (0, String::new()));
    finished.stdout().lines().map(str::to_owned).collect()
}

fn set(texts: &[&str]) -> BTreeSet<String> {
    texts.iter().map(|it| (*it).to_owned()).collect()
}

#[test]
fn completions_know_every_command() {
    for shell in ["bash", "zsh", "fish"] {
        let script = run(&["completions", shell]);
        assert_eq!((script.code(), script.stderr()), (0, String::new()));
        // The script of `source <(COMPLETE=bash sm2)` is the same.
        let mut command = sm2(&[]);
        let again = Running::start(command.env("COMPLETE", shell)).finish();
        assert_eq!(again.code(), 0, "{again:?}");
        assert!(script.stdout().contains("COMPLETE"), "{script:?}");
    }
    let none = Path::new("/nonexistent/sm2.sock");
    let commands = complete_at(none, &[""]);
    for word in ["manager", "topic", "service", "snapshot", "doctor"] {
        assert!(commands.contains(word), "{word} is not in {commands:?}");
    }
    assert!(!commands.iter().any(|it| it.contains("demo-part")));
    assert_eq!(complete_at(none, &["topic", "e"]), set(&["echo"]));
    let options = complete_at(none, &["topic", "hz", "--wait"]);
    assert_eq!(options, set(&["--wait-manager"]));
    run(&["completions", "tcsh"]).failed(2, &["bash", "zsh", "fish"]);
    run(&["completions"]).failed(2, &["SHELL"]);
}

#[test]
fn completions_know_the_domain() {
    let domain = Domain::new();
    let node = domain.node("robot/driver");
    let _scan = node.publisher::<str>("scan").unwrap();
    let _camera = node.publisher::<[u8]>("camera/front").unwrap();
    let _sum = node.server::<str, str>("sum").unwrap();
    let mut builder = node.parameters_builder();
    drop(builder.parameter("max_range", 30.0).add());
    let _parameters = builder.declare().unwrap();
    let socket = domain.path("sm2.sock");
    let complete = |words: &[&str]| complete_at(&socket, words);
    for command in ["info", "echo", "hz"] {
        assert_eq!(complete(&["topic", command, "sc"]), set(&["scan"]));
    }
    assert_eq!(
        complete(&["topic", "echo", "/cam"]),
        set(&["/camera/front"])
    );
    assert_eq!(complete(&["record", "scan", "cam"]), set(&["camera/front"]));
    assert_eq!(complete(&["service", "call", "s"]), set(&["sum"]));
    assert_eq!(complete(&["node", "info", "r"]), set(&["robot/driver"]));
    assert_eq!(complete(&["param", "get", "r"]), set(&["robot/driver"]));
    let parameter = ["param", "set", "robot/driver", "m"];
    assert_eq!(complete(&parameter), set(&["max_range"]));
    assert_eq!(
        complete(&["why", "robot/driver:s"]),
        set(&["robot/driver:scan", "robot/driver:sum"])
    );
    assert_eq!(complete(&["why", "scan", "sc"]), set(&["scan"]));
    assert_eq!(complete(&["wait", "topic:s"]), set(&["topic:scan"]));
    // Bash splits words at colons.
    assert_eq!(complete(&["wait", "topic", ":", "s"]), set(&["scan"]));
    // The options of the line come before the environment.
    let other = ["topic", "echo", "--socket", "/nonexistent/sm2.sock", "sc"];
    assert_eq!(complete(&other), set(&[]));
    let path = socket.to_str().unwrap();
    let words = ["topic", "echo", "--socket", path, "sc"];
    let none = Path::new("/nonexistent/sm2.sock");
    assert_eq!(complete_at(none, &words), set(&["scan"]));
}

#[test]
fn completions_do_not_wait_for_a_manager() {
    let none = Path::new("/nonexistent/sm2.sock");
    assert_eq!(complete_at(none, &["topic", "echo", "sc"]), set(&[]));
    let domain = Domain::new();
    domain.signal_manager(Signal::SIGSTOP);
    let stopped = complete_at(&domain.path("sm2.sock"), &["topic", "echo", "sc"]);
    domain.signal_manager(Signal::SIGCONT);
    assert_eq!(stopped, set(&[]));
}

/// The names of the domain, as each shell shows them.
struct InShell {
    domain: Domain,
    _node: sm2_node::Node,
    _interfaces: (sm2_node::Publisher<str>, sm2_node::Server<str, str>),
}

impl InShell {
    fn new() -> Self {
        let domain = Domain::new();
        let node = domain.node("robot/driver");
        let scan = node.publisher::<str>("scan").unwrap();
        let sum = node.server::<str, str>("sum").unwrap();
        Self {
            domain,
            _node: node,
            _interfaces: (scan, sum),
        }
    }

    /// The lines that a shell prints; `None` if there is no such shell here.
    fn output(&self, shell: &str, arguments: &[&str]) -> Option<Vec<String>> {
        let program = sm2(&[]).get_program().to_owned();
        let folder = Path::new(&program).parent().unwrap().to_owned();
        let path = std::env::var("PATH").unwrap();
        let home = tempfile::tempdir().unwrap();
        let mut command = Command::new(shell);
        command
            .args(arguments)
            .env("PATH", format!("{}:{path}", folder.display()))
            .env("SM2_SOCKET", self.domain.path("sm2.sock"))
            .env("HOME", home.path())
            .env_remove("ZDOTDIR")
            .env_remove("XDG_CONFIG_HOME")
            .stdin(Stdio::null());
        match command.output() {
            Ok(output) => {
                assert!(output.status.success(), "{output:?}");
                let text = String::from_utf8(output.stdout).unwrap();
                Some(text.lines().map(str::to_owned).collect())
            }
            Err(error) => {
                skip_without(shell, error);
                None
            }
        }
    }
}

#[test]
fn bash_completes_a_topic() {
    let script = "source <(COMPLETE=bash sm2) && COMP_WORDS=(sm2 topic echo sc) COMP_CWORD=3 \
        && _clap_complete_sm2 sm2 sc echo && echo \"${COMPREPLY[@]}\"";
    if let Some(lines) = InShell::new().output("bash", &["--norc", "-c", script]) {
        assert_eq!(lines, ["scan"]);
    }
}

#[test]
fn fish_completes_names() {
    let shell = InShell::new();
    for (line, expected) in [
        ("sm2 topic echo sc", vec!["scan"]),
        ("sm2 node info r", vec!["robot/driver"]),
        ("sm2 service call s", vec!["sum"]),
        ("sm2 wait topic:s", vec!["topic:scan"]),
        (
            "sm2 why robot/driver:s",
            vec!["robot/driver:scan", "robot/driver:sum"],
        ),
        ("sm2 topic e", vec!["echo"]),
    ] {
        let script = format!("sm2 completions fish | source; complete -C '{line}'");
        let Some(lines) = shell.output("fish", &["--no-config", "-c", &script]) else {
            return;
        };
        // A tabulator separates the name from its description.
        let names: Vec<_> = lines
            .iter()
            .filter_map(|it| it.split('\t').next())
            .collect();
        assert_eq!(names, expected, "{line}: {lines:?}");
    }
}

/// Completes in an interactive zsh on a terminal of its own, which begins with `$1`. Prints each line of `$@[2,-1]`
/// after its completion. A second Tab shows nothing that the first one has not.
const ZSH: &str = r#"
zmodload zsh/zpty
sm2 completions zsh >$HOME/_sm2
cat >$HOME/.zshrc <<'end'
autoload -Uz compinit
setopt no_beep no_prompt_sp
show() { print -r -- "<$BUFFER>"; BUFFER= }
zle -N show
bindkey '^X' show
end
print -r -- $1 >>$HOME/.zshrc
export ZDOTDIR=$HOME TERM=dumb
zpty z zsh -d -i
for line in $@[2,-1]; do
    zpty -w -n z $line$'\t\x18'
    seen=
    for _ in {1..600}; do
        zpty -r -t z part && seen+=$part && [[ $seen == *\<*\>* ]] && break
        sleep 0.1
    done
    print -r -- ${${seen#*\<}%%\>*}
done
zpty -d z
"#;

#[test]
fn zsh_completes_names() {
    let shell = InShell::new();
    let sourced = "compinit -u -D; source <(sm2 completions zsh)";
    let in_path = "fpath=($HOME $fpath); compinit -u -D";
    for setup in [sourced, in_path] {
        let lines = [
            "sm2 topic echo sc",
            "sm2 node info r",
            "sm2 service call s",
            "sm2 wait topic:s",
            "sm2 why robot/driver:sc",
            "sm2 topic e",
        ];
        let arguments = [&["-f", "-c", ZSH, "zsh", setup][..], &lines].concat();
        let Some(completed) = shell.output("zsh", &arguments) else {
            return;
        };
        let expected = [
            "sm2 topic echo scan ",
            "sm2 node info robot/driver ",
            "sm2 service call sum ",
            "sm2 wait topic:scan ",
            "sm2 why robot/driver:scan ",
            "sm2 topic echo ",
        ];
        assert_eq!(completed, expected, "{setup}");
    }
}

#[test]
fn the_shells_take_the_completions() {
    for (shell, check) in [("bash", "-n"), ("zsh", "-n"), ("fish", "--no-execute")] {
        let folder = tempfile::tempdir().unwrap();
        let script = folder.path().join("script");
        fs::write(&script, run(&["completions", shell]).stdout()).unwrap();
        let mut command = Command::new(shell);
        match command
            .arg(check)
            .arg(&script)
            .stdin(Stdio::null())
            .output()
        {
            Ok(checked) => assert!(checked.status.success(), "{shell}: {checked:?}"),
            Err(error) => skip_without(shell, error),
        }
    }
}

#[test]
fn pages_are_printed_and_written() {
    let page = run(&["man"]);
    assert_eq!(page.code(), 0);
    let page = page.stdout();
    for part in [
        ".TH sm2 1",
        ".SH NAME",
        ".SH EXAMPLES",
        ".SH ENVIRONMENT",
        ".SH EXIT STATUS",
        "sm2\\-topic",
    ] {
        assert!(page.contains(part), "{part} is not in\n{page}");
    }
    let page = run(&["man", "topic", "hz"]).stdout();
    assert!(page.contains(".TH sm2-topic-hz 1"), "{page}");
    // Commands to copy keep their lines.
    assert!(page.contains(".SH EXAMPLES\n.nf\n"), "{page}");
    run(&["man", "topic", "hertz"]).failed(2, &["sm2 topic hertz"]);

    let folder = tempfile::tempdir().unwrap();
    let into = folder.path().join("man1");
    let written = run(&["man", "--dir", into.to_str().unwrap()]);
    assert_eq!(
        (written.code(), written.stdout()),
        (0, String::new()),
        "{written:?}"
    );
    let pages = files(&into);
    let names: Vec<_> = pages.iter().map(|(name, _)| name.as_str()).collect();
    for name in [
        "sm2.1",
        "sm2-topic.1",
        "sm2-topic-hz.1",
        "sm2-service-call.1",
        "sm2-manager.1",
    ] {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
    assert!(
        !names
            .iter()
            .any(|name| name.contains("demo-part") || name.contains("help"))
    );
    for (name, page) in &pages {
        let page = String::from_utf8_lossy(page);
        assert!(
            page.contains(".SH EXAMPLES"),
            "{name} has no examples:\n{page}"
        );
        // No heading appears twice.
        for heading in page.lines().filter(|line| line.starts_with(".SH ")) {
            assert_eq!(
                page.matches(&format!("{heading}\n")).count(),
                1,
                "{name}: {heading}"
            );
        }
    }
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    run(&["man", "--dir", file.to_str().unwrap()]).failed(1, &["cannot create folder"]);
}
