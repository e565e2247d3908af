//! `sm2 demo`, small.

use std::{collections::BTreeSet, process::Command};

use serde_json::Value;
use sm2_test_support::skip;

use crate::common::{Finished, Running, sm2};

fn demo(options: &[&str]) -> Finished {
    let small = ["demo", "--subscribers", "2", "--rate", "50"];
    Running::start(&mut sm2(&[&small, options].concat())).finish()
}

fn keys(value: &Value) -> BTreeSet<&str> {
    value
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect()
}

/// A new network namespace has a loopback interface that is down.
#[test]
fn a_missing_loopback_interface_is_named() {
    let isolated = |program: &[&str]| {
        let mut command = Command::new("unshare");
        // The user is not root in the new user namespace, so the demo cannot create network namespaces.
        command.args(["--net", "--map-user=1000"]).args(program);
        Running::start(&mut command).finish()
    };
    let unshared = Command::new("unshare")
        .args(["--net", "--map-user=1000", "true"])
        .status();
    match unshared {
        Ok(status) if status.success() => {}
        other => return skip(format_args!("unshare does not work here: {other:?}")),
    }
    let demo = isolated(&[env!("CARGO_BIN_EXE_sm2"), "demo", "--bad-link"]);
    let expected = [
        "since network namespaces need root",
        "run `ip link set lo up`",
    ];
    demo.failed(1, &expected);
}

/// Checks the promises about the JSON report.
fn judge(report: &Value, integrity: &str, size: u64) {
    let expected = [
        "published",
        "size_bytes",
        "integrity",
        "interrupted",
        "subscribers",
        "cpu_percent_total",
        "pss_bytes_total",
        "wall_s",
    ];
    assert_eq!(keys(report), BTreeSet::from(expected));
    assert_eq!(report["integrity"], integrity);
    assert_eq!(report["interrupted"], false);
    assert_eq!(report["size_bytes"], size);
    let published = report["published"].as_u64().unwrap();
    assert!((1..=20).contains(&published), "{report}");
    assert!(report["wall_s"].as_f64().unwrap() > 0.0);
    assert!(report["cpu_percent_total"].as_f64().is_some());
    assert!(
        report["pss_bytes_total"]
            .as_u64()
            .is_none_or(|bytes| bytes > 0)
    );
    let subscribers = report["subscribers"].as_array().unwrap();
    assert_eq!(subscribers.len(), 2);
    for subscriber in subscribers {
        let expected = ["received", "lost", "damaged", "hz", "latency_us"];
        assert_eq!(keys(subscriber), BTreeSet::from(expected));
        let latency = &subscriber["latency_us"];
        assert_eq!(keys(latency), BTreeSet::from(["p50", "p99", "max"]));
        let of = |what: &str| latency[what].as_f64().unwrap();
        assert!(
            of("p50") > 0.0 && of("p50") <= of("p99") && of("p99") <= of("max"),
            "{report}"
        );
        assert_eq!(subscriber["damaged"], 0);
        let received = subscriber["received"].as_u64().unwrap();
        assert!(received > 0);
        assert_eq!(received + subscriber["lost"].as_u64().unwrap(), published);
    }
}

#[test]
fn json_is_one_object_and_nothing_else() {
    let all = [
        ("pooled", "16", 16),
        ("pooled", "1.5MB", 1_500_000),
        ("sealed", "300001", 300_001),
        ("pooled", "4097", 4_097),
        ("sealed", "100", 100),
    ];
    let tried = if cfg!(feature = "slow") { 5 } else { 3 };
    for (integrity, size, bytes) in all.into_iter().take(tried) {
        let options = [
            "--integrity",
            integrity,
            "--size",
            size,
            "--seconds",
            "0.4",
            "--json",
        ];
        let finished = demo(&options);
        assert_eq!(finished.code(), 0, "{}", finished.stderr());
        assert_eq!(finished.stderr(), "");
        let stdout = finished.stdout();
        assert_eq!(stdout.lines().count(), 1, "{stdout}");
        judge(&serde_json::from_str(&stdout).unwrap(), integrity, bytes);
    }
}

#[test]
fn people_get_a_line_each_second_and_a_summary() {
    let options = [
        "--size",
        "64kB",
        "--seconds",
        "1.5",
        "--integrity",
        "sealed",
    ];
    let finished = demo(&options);
    assert_eq!(finished.code(), 0, "{}", finished.stderr());
    let stdout = finished.stdout();
    let lines: Vec<_> = stdout.lines().collect();
    assert!(
        lines[0].starts_with("1 publisher, 2 subscribers: 64 kB at 50 Hz"),
        "{stdout}"
    );
    assert!(
        lines[1].contains("Hz") && lines[1].contains("damaged 0"),
        "{stdout}"
    );
    let rows = lines.iter().filter(|line| line.starts_with("subscriber "));
    assert_eq!(rows.count(), 2, "{stdout}");
    assert!(lines.last().unwrap().contains("sealed"), "{stdout}");
    assert!(!stdout.contains('\x1b'), "{stdout}");
}

#[test]
fn two_demos_at_a_time_do_not_see_each_other() {
    let demos: Vec<_> = (0..2)
        .map(|_| {
            let demo = [
                "demo",
                "--subscribers",
                "2",
                "--size",
                "8kB",
                "--seconds",
                "0.3",
                "--json",
            ];
            Running::start(&mut sm2(&demo))
        })
        .collect();
    for demo in demos {
        let finished = demo.finish();
        assert_eq!(finished.code(), 0, "{}", finished.stderr());
        let report: Value = serde_json::from_str(&finished.stdout()).unwrap();
        assert_eq!(report["subscribers"].as_array().unwrap().len(), 2);
    }
}
