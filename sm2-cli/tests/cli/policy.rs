//! `sm2 policy`.

use std::fs;

use tempfile::TempDir;

use crate::{
    common::{Domain, Finished, Running, sm2},
    help::help,
};

const POLICY: &str = "\
default = \"deny\"

[[rule]]
name = \"arm\"
effect = \"allow\"
actions = [\"publish\", \"subscribe\"]
names = [\"arm/**\", \"cmd_vel\"]
users = [7]
nodes = [\"arm/*\"]

[[rule]]
effect = \"allow\"
actions = [\"see\"]
names = [\"**\"]
groups = [9]

[[binding]]
name = \"arms\"
nodes = [\"arm/**\"]
users = [7]

[[exclusive]]
name = \"motion\"
topics = [\"cmd_vel\"]
";

struct Folder(TempDir);

impl Folder {
    fn with(text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("policy.toml"), text).unwrap();
        Self(folder)
    }

    fn run(&self, arguments: &str) -> Finished {
        let words: Vec<_> = arguments.split(' ').collect();
        Running::start(sm2(&words).current_dir(self.0.path())).finish()
    }

    fn explain(&self, arguments: &str) -> (i32, String) {
        let finished = self.run(&format!("policy explain policy.toml {arguments}"));
        assert_eq!(finished.stderr(), "", "{arguments}");
        (finished.code(), finished.stdout())
    }
}

#[test]
fn check_counts_and_warns() {
    let checked = Folder::with(POLICY).run("policy check policy.toml");
    let counts = "policy.toml: 2 rules, 1 binding, 1 exclusive table; default deny\n";
    assert_eq!((checked.code(), checked.stdout()), (0, counts.to_owned()));
    let unbound = POLICY
        .replacen("users = [7]\n", "", 1)
        .replace("arm/**", "leg");
    let checked = Folder::with(&unbound).run("policy check policy.toml");
    assert_eq!(checked.code(), 0);
    let stdout = checked.stdout();
    assert!(
        stdout.contains("\nwarning: rule `arm` in line 3 "),
        "{stdout}"
    );
}

/// The help shows a file with all keys, whose users and groups not every machine has.
#[test]
fn the_file_in_the_help_is_a_policy() {
    let help = help(&["policy", "check"]);
    let (_, sample) = help.split_once("all keys:\n\n").unwrap();
    let (sample, _) = sample.split_once("\n\n").unwrap();
    let sample = sample
        .replace("\"robot\"", "\"root\"")
        .replace("video", "root");
    let checked = Folder::with(&sample).run("policy check policy.toml");
    let counts = "policy.toml: 1 rule, 1 binding, 1 exclusive table; default deny\n";
    assert_eq!((checked.code(), checked.stdout()), (0, counts.to_owned()));
}

#[test]
fn a_file_that_is_no_policy_is_refused_with_its_line() {
    let folder = Folder::with(
        "default = \"deny\"\n[[rule]]\neffect = \"allow\"\nname = \"a\"\nnames = [\"a*\"]",
    );
    let words = ["policy.toml:5: names: `a*`:"];
    folder.run("policy check policy.toml").failed(1, &words);
    let explain = "policy explain policy.toml --node a --action see --name b";
    folder.run(explain).failed(1, &words);
    folder
        .run("policy check other.toml")
        .failed(1, &["other.toml", "No such file"]);
}

#[test]
fn explain_names_what_decides() {
    let folder = Folder::with(POLICY);
    let arm = "--user 7 --group 1 --node arm/left --name arm/goal --action";
    assert_eq!(
        folder.explain(&format!("{arm} publish")),
        (
            0,
            "publish arm/goal: allowed by the rule `arm` at policy.toml:3\n".to_owned()
        )
    );
    assert_eq!(
        folder.explain(&format!("{arm} serve")),
        (
            1,
            "serve arm/goal: denied by the default of policy.toml, as no rule matches\n".to_owned()
        )
    );
    let (status, text) =
        folder.explain("--user 7 --group 1 --node arm/left --name cmd_vel --action publish");
    assert_eq!(status, 0);
    assert!(
        text.ends_with(
            "\ncmd_vel has at most one publisher, by the entry `motion` at policy.toml:22\n"
        ),
        "{text}"
    );
    // The rule allows it, but the name of the node is that of another user.
    let (status, text) =
        folder.explain("--user 8 --group 9 --node arm/left --name arm/goal --action see");
    assert_eq!(status, 1);
    assert_eq!(
        text,
        "arm/left is denied as a name by the binding `arms` at policy.toml:17\n\
         see arm/goal: allowed by the rule `rule-2` at policy.toml:11\n"
    );
}

#[test]
fn the_user_and_its_groups_are_the_present_ones_unless_named() {
    let gid = nix::unistd::getgid().as_raw();
    let text = format!(
        "default = \"deny\"\n[[rule]]\neffect = \"allow\"\nnames = [\"**\"]\nusers = [{}]\ngroups = [{gid}]",
        nix::unistd::getuid().as_raw()
    );
    let folder = Folder::with(&text);
    let question = "--node a --action read-counters --name b";
    assert_eq!(folder.explain(question).0, 0);
    assert_eq!(
        folder.explain(&format!("{question} --user 4000000000")).0,
        1
    );
    assert_eq!(
        folder.explain(&format!("{question} --group 4000000000")).0,
        1
    );
    let failed = folder.run(&format!(
        "policy explain policy.toml {question} --user nobody-here"
    ));
    failed.failed(2, &["no such user"]);
}

#[test]
fn reload_waits_until_the_policy_is_applied() {
    let folder = Folder::with("default = \"allow\"\n");
    let file = folder.0.path().join("policy.toml");
    let domain = Domain::with(&["--policy", file.to_str().unwrap()]);
    let node = domain.node("talker");
    let publisher = node.publisher::<u64>("numbers").unwrap();
    fs::write(&file, "default = \"deny\"\n").unwrap();
    let reloaded = domain.run(&["policy", "reload"]);
    assert_eq!(reloaded.code(), 0, "{reloaded:?}");
    assert_eq!(reloaded.stdout(), "the access policy is applied\n");
    node.spin_some().unwrap();
    assert!(!publisher.is_registered());
    fs::write(&file, "default = \"all\"\n").unwrap();
    let unusable = domain.run(&["policy", "reload"]);
    let words = [
        "policy before stays in force",
        "policy.toml:1: unknown variant `all`",
    ];
    unusable.failed(1, &words);
}

#[test]
fn reload_says_why_nothing_is_applied() {
    let domain = Domain::new();
    let none = domain.run(&["policy", "reload"]);
    none.failed(1, &["this domain has no access policy"]);
    let mut other = sm2(&["policy", "reload", "--socket", "/nowhere/sm2.sock"]);
    Running::start(&mut other)
        .finish()
        .failed(1, &["no Manager answers"]);
}
