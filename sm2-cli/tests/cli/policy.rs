//! `sm2 policy`.

use std::fs;

use tempfile::TempDir;

use crate::{
    common::{Domain, Finished, Running, sm2, talker, until},
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
fn answers_are_objects() {
    let folder = Folder::with(POLICY);
    let json = |arguments: &str| {
        let finished = folder.run(&format!("policy {arguments} --json"));
        assert_eq!(finished.stderr(), "", "{arguments}");
        serde_json::from_str::<serde_json::Value>(&finished.stdout()).unwrap()
    };
    let checked = json("check policy.toml");
    assert_eq!(
        (&checked["rules"], &checked["bindings"]),
        (&2.into(), &1.into())
    );
    assert_eq!(checked["default"], "deny");
    let user = "--user 7 --group 7 --node arm/left --action publish --name cmd_vel";
    let explained = json(&format!("explain policy.toml {user}"));
    assert_eq!(explained["allowed"], true);
    assert_eq!(
        explained["rule"],
        serde_json::json!({"name": "arm", "line": 3})
    );
    assert_eq!(explained["exclusive"]["name"], "motion");
    let other = user.replace("--user 7", "--user 8");
    let denied = json(&format!("explain policy.toml {other}"));
    assert_eq!(
        (&denied["allowed"], &denied["binding"]["name"]),
        (&false.into(), &"arms".into())
    );
}

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

/// The domain of the round trip: what it does, and a node that does something else later.
struct Robot {
    nodes: [sm2_node::Node; 2],
    publisher: sm2_node::Publisher<u64>,
    subscriber: sm2_node::Subscriber<u64>,
    _server: sm2_node::Server<u64, u64>,
    client: sm2_node::Client<u64, u64>,
}

impl Robot {
    fn start(domain: &Domain) -> Self {
        let [base, arm] = ["base", "arm/left"].map(|it| domain.node(it));
        Self {
            publisher: base.publisher("odometry").unwrap(),
            subscriber: arm.subscriber("odometry").unwrap(),
            _server: arm.server("move").unwrap(),
            client: base.client("move").unwrap(),
            nodes: [base, arm],
        }
    }

    fn works(&self) {
        let open = |links: &[sm2_node::diagnostics::LinkStatus]| links.iter().any(|it| it.open);
        let spin = || {
            for node in &self.nodes {
                node.spin_some().unwrap();
            }
        };
        until("all are linked", || {
            spin();
            open(&self.publisher.links()) && open(&self.client.links())
        });
        self.publisher.publish(&7).unwrap();
        until("a message", || {
            spin();
            self.subscriber
                .try_recv()
                .unwrap()
                .is_some_and(|it| *it == 7)
        });
    }
}

#[test]
fn a_domain_works_by_the_policy_that_was_learned_from_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("learned.toml");
    let learned = file.to_str().unwrap();
    {
        let domain = Domain::new();
        let robot = Robot::start(&domain);
        robot.works();
        // The name of this node contains the number of its process.
        let (_talker, _) = talker(&domain, "chatter");
        let done = domain.run(&["policy", "learn", "--exclusive", "-o", learned]);
        assert_eq!((done.code(), done.stdout()), (0, String::new()), "{done:?}");
        let printed = domain.run(&["policy", "learn", "--exclusive"]).stdout();
        assert_eq!(printed, fs::read_to_string(&file).unwrap());
    }
    let checked = Running::start(&mut sm2(&["policy", "check", learned])).finish();
    let counts = format!("{learned}: 6 rules, 0 bindings, 1 exclusive table; default deny\n");
    assert_eq!((checked.code(), checked.stdout()), (0, counts));
    let domain = Domain::with(&["--policy", learned]);
    let robot = Robot::start(&domain);
    robot.works();
    let (_talker, _) = talker(&domain, "chatter");
    let other = domain.node("other");
    let base = &robot.nodes[0];
    let denied = [
        other.publisher::<u64>("odometry").err(),
        base.publisher::<u64>("other").err(),
        base.subscriber::<u64>("odometry").err(),
    ];
    assert!(denied.iter().all(Option::is_some), "{denied:?}");
    let exclusive = base.publisher::<u64>("odometry").unwrap_err();
    assert!(exclusive.to_string().contains("exclusive-1"), "{exclusive}");
}

#[test]
fn learn_watches_and_ctrl_c_ends_it() {
    let domain = Domain::new();
    let first = domain.node("first");
    let one = first.publisher::<u64>("a").unwrap();
    let watch = domain.start(&["policy", "learn", "--seconds", "600", "--exclusive"]);
    until("the command is there", || {
        let nodes = domain.list("node");
        let mut nodes = nodes["nodes"].as_array().unwrap().iter();
        nodes.any(|it| it["name"] == format!("sm2-policy-{}", watch.pid()))
    });
    // The command reads the domain once more at its end.
    let other = domain.node("second");
    let two = other.publisher::<u64>("a").unwrap();
    let subscriber = first.subscriber::<u64>("b").unwrap();
    watch.signal(nix::sys::signal::Signal::SIGINT);
    let learned = watch.finish();
    drop((one, two, subscriber));
    assert_eq!(learned.code(), 0, "{learned:?}");
    let text = learned.stdout();
    for part in ["nodes = [\"second\"]", "names = [\"b\"]"] {
        assert!(text.contains(part), "{part} is not in {text}");
    }
    assert!(
        !text.contains("[[exclusive]]"),
        "it had two publishers: {text}"
    );
}
