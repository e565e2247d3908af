//! `sm2 gateway`, and the demo of a bad link.

use std::{fs, os::unix::fs::PermissionsExt};

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::common::{Domain, Finished, Running, sm2, talker, until};

/// A domain with a key and a configuration.
struct Side {
    domain: Domain,
    id: String,
}

impl Side {
    fn new(name: &str) -> Self {
        let domain = Domain::new();
        let key = domain.path("gateway.key");
        let made = Running::start(sm2(&["gateway", "keygen"]).arg(&key)).finish();
        assert_eq!(made.code(), 0, "{made:?}");
        let text = format!(
            "name = \"{name}\"\nlisten = \"127.0.0.1:0\"\nkey = \"gateway.key\"\n\
             socket = \"sm2.sock\"\n\n[[rule]]\naction = \"deny\"\nnames = \"secret/**\"\n\
             [[rule]]\naction = \"allow\"\nnames = \"**\"\n"
        );
        fs::write(domain.path("gateway.toml"), text).unwrap();
        Self {
            domain,
            id: made.stdout().trim().to_owned(),
        }
    }

    /// A command that has the configuration as its first argument.
    fn gateway(&self, command: &str, arguments: &[&str]) -> Running {
        let mut command = sm2(&["gateway", command]);
        let file = self.domain.path("gateway.toml");
        Running::start(command.arg(file).args(arguments))
    }

    fn wrong(&self, file: &str) -> Finished {
        let path = self.domain.path("wrong.toml");
        fs::write(&path, file).unwrap();
        Running::start(sm2(&["gateway", "run"]).arg(path)).finish()
    }
}

/// The address where a gateway listens, from its log.
pub(crate) fn address(gateway: &Running) -> String {
    gateway.await_stderr("gateway started");
    let mut address = String::new();
    until("the address is in the log", || {
        let log = gateway.stderr();
        // The last line may be incomplete.
        let (whole, _) = log.rsplit_once('\n').unwrap_or_default();
        let rest = whole.split("address=").nth(1);
        address = rest.map_or_else(String::new, |it| {
            it.split_whitespace().next().unwrap().to_owned()
        });
        !address.is_empty()
    });
    address
}

#[test]
fn two_domains_as_the_readme_says() {
    let (near, far) = (Side::new("near"), Side::new("far"));
    let file = near.domain.path("gateway.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(
        &file,
        format!("{text}\n[limits]\nmessage_bytes = 5000000\n"),
    )
    .unwrap();
    assert_eq!(near.gateway("trust", &["far", &far.id]).finish().code(), 0);
    let left = near.gateway("run", &[]);
    trust_near(&far, &near.id, &address(&left));
    let right = far.gateway("run", &[]);
    let peers = |side: &Side| side.domain.run(&["gateway", "peers", "--json"]);
    until("connected", || {
        let peers = peers(&near);
        peers.code() == 0 && peers.stdout().contains("\"name\":\"far\"")
    });
    let echo = far
        .domain
        .start(&["topic", "echo", "chatter", "--count", "1"]);
    let talking = near.domain.start(&[
        "topic",
        "pub",
        "chatter",
        "--from",
        "/etc/hostname",
        "--loop",
        "--rate",
        "20",
    ]);
    assert_eq!(echo.finish().code(), 0);
    let report: Value = serde_json::from_str(&peers(&near).stdout()).unwrap();
    assert_eq!(report["peers"][0]["offered"][0], "topic chatter");
    assert_eq!(report["limits"]["message_bytes"], 5_000_000);
    let text = near.domain.run(&["gateway", "peers"]).stdout();
    let limits = "limits: message_bytes 5000000, memory_bytes 134217728, gateway_bytes 536870912";
    assert!(text.contains(limits), "{text}");
    assert!(report["peers"][0]["messages"]["sent"].as_u64().unwrap() > 0);
    snapshots_show_gateways(&near);
    objects_and_ages(&near, &report, &text);
    let check = near.gateway("check", &[]).finish();
    assert!(
        check.stdout().contains("far may have topic chatter (line"),
        "{check:?}"
    );
    asks(&far, "chatter", "near", (0, "offered"));
    asks(
        &far,
        "secret/chatter",
        "near",
        (1, "denied by the rules of the peer"),
    );
    asks(&far, "silence", &near.id, (1, "absent"));
    asks(&far, "chatter", "nobody", (1, "no such peer"));
    drop(talking);
    left.signal(Signal::SIGTERM);
    assert_eq!(left.finish().code(), 0);
    until("lost", || !peers(&far).stdout().contains("near\",\"id"));
    asks(&far, "chatter", "near", (1, "not connected"));
    right.signal(Signal::SIGINT);
    assert_eq!(right.finish().code(), 0);
    let none = peers(&far);
    assert_eq!(none.code(), 1);
    assert!(none.stderr().contains("has no gateway"), "{none:?}");
}

/// Makes `far` trust the gateway `near` at `address`, after attempts that fail.
fn trust_near(far: &Side, near_id: &str, address: &str) {
    let neither = far
        .gateway("trust", &["near", near_id, "localhost"])
        .finish();
    let said = neither.stderr();
    assert_eq!(neither.code(), 2, "{said}");
    assert!(said.contains("nor the name of a host with one"), "{said}");
    let (_, port) = address.rsplit_once(':').unwrap();
    let host = format!("localhost:{port}");
    let trusted = far.gateway("trust", &["near", near_id, &host]).finish();
    assert_eq!(trusted.code(), 0, "{trusted:?}");
    let twice = far.gateway("trust", &["near", near_id]).finish();
    assert_eq!(twice.code(), 1);
    assert!(
        twice.stderr().contains("two peers of the name near"),
        "{twice:?}"
    );
}

/// Asks a peer of `side` whether the peer offers a topic to `side`.
fn asks(side: &Side, name: &str, peer: &str, expected: (i32, &str)) {
    let asked = (side.domain).run(&["gateway", "ask", name, "--peer", peer]);
    let (code, answer) = expected;
    assert_eq!(asked.code(), code, "{asked:?}");
    let line = format!("{name} of {peer}: {answer}");
    assert!(asked.stdout().starts_with(&line), "{asked:?}");
}

/// `explain`, `check` and `ask` while `chatter` is carried to `far`, and while one of two gateways is stuck.
fn snapshots_show_gateways(near: &Side) {
    let count = |of: &Value, what: &str| of[what].as_u64().unwrap();
    // A busy gateway may answer too late for a snapshot, or have more messages in flight.
    until("a snapshot where all messages have their end", || {
        let snapshot = near.domain.json(&["snapshot"]);
        let gateway = &snapshot["gateways"][0];
        assert_eq!(gateway["service"], "gateway/near/status");
        if gateway["report"].is_null() {
            assert!(gateway["error"].is_string(), "{gateway}");
            return false;
        }
        let peer = &gateway["report"]["peers"][0];
        assert_eq!((&peer["name"], &peer["denied"]), (&"far".into(), &0.into()));
        let chatter = &peer["subjects"][0];
        assert_eq!(
            (&chatter["kind"], &chatter["name"]),
            (&"topic".into(), &"chatter".into())
        );
        [chatter, &peer["messages"]].into_iter().all(|counts| {
            let ends = ["sent", "superseded", "expired", "withdrawn"];
            let ended: u64 = ends.iter().map(|it| count(counts, it)).sum();
            assert!(count(counts, "sent") > 0, "{counts}");
            assert_eq!(count(counts, "lost"), 0);
            (ended..=ended + 2).contains(&count(counts, "offered"))
        })
    });
    until("a snapshot in text", || {
        let text = near.domain.run(&["snapshot"]).stdout();
        text.contains("SUPERSEDED") && text.contains("topic chatter")
    });
    a_stuck_gateway_is_shown(near);
}

/// Snapshots while one of two gateways is stuck.
fn a_stuck_gateway_is_shown(near: &Side) {
    let second = fs::read_to_string(near.domain.path("gateway.toml")).unwrap();
    let second = second.replace("\"near\"", "\"second\"");
    let file = near.domain.path("second.toml");
    fs::write(&file, second).unwrap();
    let stuck = Running::start(sm2(&["gateway", "run"]).arg(&file));
    stuck.await_stderr("gateway started");
    stuck.signal(Signal::SIGSTOP);
    until("the report of the other gateway", || {
        let snapshot = near.domain.json(&["snapshot"]);
        let gateways = snapshot["gateways"].as_array().unwrap();
        assert_eq!(gateways.len(), 2, "{snapshot}");
        assert_eq!(gateways[1]["service"], "gateway/second/status");
        assert!(
            gateways[1]["report"].is_null() && gateways[1]["error"].is_string(),
            "{snapshot}"
        );
        gateways[0]["report"]["name"] == "near"
    });
    stuck.signal(Signal::SIGCONT);
}

#[test]
fn trust_adds_a_peer_that_a_rule_names_already() {
    let (near, far) = (Side::new("near"), Side::new("far"));
    let file = near.domain.path("gateway.toml");
    let mut text = fs::read_to_string(&file).unwrap();
    text += "[[rule]]\naction = \"deny\"\nnames = \"**\"\npeers = [\"far\", \"later\"]\n";
    fs::write(&file, &text).unwrap();
    let unknown = near.gateway("run", &[]).finish();
    assert!(
        unknown.stderr().contains("has the name `far`"),
        "{unknown:?}"
    );
    let trusted = near.gateway("trust", &["far", &far.id]).finish();
    assert_eq!(trusted.code(), 0, "{trusted:?}");
    let unknown = near.gateway("run", &[]).finish();
    assert!(
        unknown.stderr().contains("has the name `later`"),
        "{unknown:?}"
    );
    // Every other check stays.
    fs::write(&file, text.replace("\"deny\"", "\"refuse\"")).unwrap();
    let wrong = near.gateway("trust", &["far", &far.id]).finish();
    assert!(wrong.stderr().contains("refuse"), "{wrong:?}");
}

/// `check --json`, and the age of the connection in both forms of `peers`.
fn objects_and_ages(near: &Side, report: &Value, text: &str) {
    let checked = near.gateway("check", &["--json"]).finish().stdout();
    let checked: Value = serde_json::from_str(&checked).unwrap();
    let allowed = &checked["allowed"][0];
    assert_eq!(
        (&allowed["peer"], &allowed["name"]),
        (&"far".into(), &"chatter".into())
    );
    assert!(report["peers"][0]["connected_s"].is_number(), "{report}");
    assert!(text.contains(", connected for "), "{text}");
}

#[test]
fn explain_names_the_rule() {
    let (near, far) = (Side::new("near"), Side::new("far"));
    near.gateway("trust", &["far", &far.id]).finish();
    let file = near.domain.path("gateway.toml");
    let explain_with = |name: &str, peer: &str, option: Option<&str>| {
        let mut command = sm2(&[
            "gateway",
            "explain",
            name,
            "--peer",
            peer,
            "--direction",
            "out",
        ]);
        Running::start(command.arg("--config").arg(&file).args(option)).finish()
    };
    let explain = |name: &str, peer: &str| explain_with(name, peer, None);
    let object = explain_with("camera", "far", Some("--json")).stdout();
    let object: Value = serde_json::from_str(&object).unwrap();
    assert_eq!(
        (&object["name"], &object["allowed"]),
        (&"camera".into(), &true.into())
    );
    assert!(object["line"].is_u64(), "{object}");
    let allowed = explain("camera", "far");
    assert_eq!(allowed.code(), 0);
    assert!(
        allowed
            .stdout()
            .starts_with("camera: allowed by the rule at "),
        "{allowed:?}"
    );
    let denied = explain("secret/camera", &far.id);
    assert_eq!(denied.code(), 1);
    assert!(denied.stdout().contains("denied by the rule"), "{denied:?}");
    assert_ne!(
        allowed.stdout().rsplit(':').next(),
        denied.stdout().rsplit(':').next()
    );
    let unknown = explain("camera", "nobody");
    assert!(
        unknown.stderr().contains("no peer nobody; its peers: far"),
        "{unknown:?}"
    );
}

#[test]
fn what_is_wrong_is_one_line_and_starts_nothing() {
    let side = Side::new("near");
    let good = fs::read_to_string(side.domain.path("gateway.toml")).unwrap();
    let say = |from: &str, to: &str, expected: &str| {
        let finished = side.wrong(&good.replace(from, to));
        assert_eq!(finished.code(), 1, "{to}");
        let error = finished.stderr();
        assert!(error.contains(expected), "{to}: {error}");
        assert_eq!(error.lines().count(), 1, "{error}");
    };
    say("allow", "alow", "wrong.toml:10: unknown variant");
    say("name =", "nam =", "wrong.toml:1: unknown field `nam`");
    say("**", "a/../b", "wrong.toml:8: `");
    say(
        "127.0.0.1:0",
        "here",
        "wrong.toml:2: `here` is not an address with a port",
    );
    say(
        "127.0.0.1:0",
        "192.0.2.1:7633",
        "cannot listen at 192.0.2.1:7633",
    );
    say("sm2.sock", "none.sock", "none.sock");
    say("gateway.key", "none.key", "sm2 gateway keygen");
    let held = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let taken = held.local_addr().unwrap().to_string();
    say("127.0.0.1:0", &taken, "cannot listen at");
    drop(held);
    let held = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = held.local_addr().unwrap().to_string();
    let run = side.gateway("run", &["--metrics", &taken]).finish();
    let said = run.stderr();
    assert_eq!((run.code(), said.lines().count()), (1, 1), "{said}");
    let expected = format!("cannot serve metrics at {taken}: ");
    assert!(said.contains(&expected), "{said}");
    let key = side.domain.path("gateway.key");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).unwrap();
    say("near", "near", "chmod 600");
    let again = Running::start(sm2(&["gateway", "keygen"]).arg(&key)).finish();
    assert!(again.stderr().contains("never overwritten"), "{again:?}");
}

#[test]
#[cfg_attr(not(feature = "slow"), ignore = "slow")]
fn the_demo_of_a_bad_link_ends_with_one_object() {
    let arguments = [
        "demo",
        "--bad-link",
        "--seconds",
        "6",
        "--size",
        "100kB",
        "--json",
    ];
    let demo = Running::start(&mut sm2(&arguments)).finish();
    assert_eq!(demo.code(), 0, "{demo:?}");
    let stdout = demo.stdout();
    let report: Value = serde_json::from_str(stdout.lines().last().unwrap()).unwrap();
    for (part, keys) in [
        (
            "local",
            &[
                "hz_before",
                "hz_after",
                "p99_us_before",
                "p99_us_after",
                "lost",
                "damaged",
            ][..],
        ),
        ("remote", &["hz", "goodput_mbit", "age_ms", "damaged"]),
        ("link", &["rate_mbit", "loss_percent", "kind"]),
    ] {
        for key in keys {
            assert!(!report[part][key].is_null(), "{part}.{key}: {report}");
        }
    }
    assert_eq!(report["local"]["damaged"], 0);
    assert_eq!(report["remote"]["damaged"], 0);
    assert!(report["remote"]["hz"].as_f64().unwrap() > 0.0, "{report}");
}

#[test]
fn a_shadow_says_what_other_rules_would_change_and_reloads() {
    let (near, far) = (Side::new("near"), Side::new("far"));
    near.gateway("trust", &["far", &far.id]).finish();
    let file = near.domain.path("gateway.toml");
    let rules = fs::read_to_string(&file).unwrap();
    let shadow = near.domain.path("shadow.toml");
    // Nothing is carried any more: an earlier rule denies all that the last one allows.
    fs::write(
        &shadow,
        rules.replace("names = \"**\"", "names = \"secret/*\""),
    )
    .unwrap();
    let line = |of: &str| {
        let text = fs::read_to_string(&shadow).unwrap();
        1 + text.lines().position(|it| it.contains(of)).unwrap() - 2
    };
    let (_first, _) = talker(&near.domain, "camera");
    let shadow_name = shadow.to_str().unwrap();
    let running = near.gateway("run", &["--shadow", shadow_name]);
    let no_longer = "far: topic camera would no longer be offered (no rule matches)";
    running.await_stderr(no_longer);
    let check = near.gateway("check", &["--shadow", shadow_name]).finish();
    assert!(check.stdout().contains(no_longer), "{check:?}");
    let peers = || near.domain.run(&["gateway", "peers"]).stdout();
    assert!(peers().contains(no_longer), "{}", peers());
    // A new topic appears, and the shadow's rules decide differently about it.
    let (_second, _) = talker(&near.domain, "secret/plan");
    let text = rules
        .replace("deny", "allow")
        .replace("\"**\"", "\"camera\"");
    fs::write(&shadow, text).unwrap();
    running.signal(Signal::SIGHUP);
    let at = line("secret/**");
    running.await_stderr(&format!(
        "far: topic secret/plan would be offered (line {at})"
    ));
    until("the first one is as it was", || {
        !peers().contains("camera would")
    });
    // A bad configuration changes nothing. Keys that need a restart are named.
    fs::write(&shadow, "nonsense").unwrap();
    let other = rules.replace("127.0.0.1", "127.0.0.2") + "\n";
    fs::write(&file, other.replace("key =", "discovery = [\"lo\"]\nkey =")).unwrap();
    running.signal(Signal::SIGHUP);
    running.await_stderr("cannot reload the shadow configuration");
    let stderr = running.stderr();
    for key in ["`listen`", "`discovery`"] {
        let warning = format!("{key} has changed: restart to use it");
        assert!(stderr.contains(&warning), "{stderr}");
    }
    assert_eq!(stderr.matches("restart to use it").count(), 2, "{stderr}");
    assert!(
        peers().contains("secret/plan would be offered"),
        "{}",
        peers()
    );
    running.signal(Signal::SIGTERM);
    assert_eq!(running.finish().code(), 0);
}
