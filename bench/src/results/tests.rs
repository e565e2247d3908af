use super::{PeerFailure, Results, join, split};
use crate::{job::Read, machine::Machine};

/// A run of two peers and two cases.
pub(crate) fn results() -> Results {
    let mut results = Results {
        workload: "fig3".to_owned(),
        read: Read::Full,
        command: "sm2-bench run fig3".to_owned(),
        began: 0,
        repeats: 3,
        machine: Machine::here(),
        figures: Vec::new(),
        failures: Vec::new(),
        skipped: Vec::new(),
    };
    for value in [3.0, 2.0, 4.0] {
        results.record("raw-futex", "1to5/cpu", "%", value / 2.0);
        results.record("sm2", "1to5/cpu", "%", value);
        results.record("sm2", "1to1/cpu", "%", 0.0);
        results.record("raw-futex", "1to1/cpu", "%", 1.0);
    }
    results.failures.push(PeerFailure {
        peer: "zenoh-tcp".to_owned(),
        workload: "fig3".to_owned(),
        case: "1to5".to_owned(),
        repeat: 2,
        failed: "publisher: broken".to_owned(),
    });
    results.conclude();
    results
}

#[test]
fn medians_and_ratios_are_of_all_runs() {
    let results = results();
    let raw = results.find("raw-futex", "1to5/cpu").unwrap();
    let summary = raw.summary;
    assert_eq!((summary.median, summary.min, summary.max), (1.5, 1.0, 2.0));
    assert_eq!(raw.ratio_to_sm2, Some(0.5));
}

#[test]
fn nothing_is_divided_by_zero() {
    let results = results();
    assert_eq!(
        results.find("raw-futex", "1to1/cpu").unwrap().ratio_to_sm2,
        None
    );
}

#[test]
fn peers_stand_in_the_order_of_the_catalogue_also_when_they_failed() {
    assert_eq!(results().peers(), ["sm2", "raw-futex", "zenoh-tcp"]);
    assert_eq!(results().cases(), ["1to5", "1to1"]);
}

#[test]
fn a_line_of_json_has_all_fields_side_by_side() {
    let results = results();
    let figure = results.find("sm2", "1to5/cpu").unwrap();
    let json = serde_json::to_value(figure).unwrap();
    let texts = ["peer", "workload", "figure", "unit"].map(|field| json[field].as_str());
    assert_eq!(
        texts,
        [Some("sm2"), Some("fig3"), Some("1to5/cpu"), Some("%")]
    );
    let numbers = ["median", "min", "max", "ratio_to_sm2"].map(|field| json[field].as_f64());
    assert_eq!(numbers, [Some(3.0), Some(2.0), Some(4.0), Some(1.0)]);
}

#[test]
fn what_is_kept_is_found_again() {
    let dir = tempfile::tempdir().unwrap();
    let results = results();
    let path = results.save(&dir.path().join("new")).unwrap();
    assert!(path.ends_with("new/fig3-full.json"));
    let found = Results::load_all(&dir.path().join("new")).unwrap();
    assert_eq!(found, [results]);
}

#[test]
fn a_file_that_is_not_understood_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("x.json"), "{}").unwrap();
    assert!(Results::load_all(dir.path()).is_err());
}

#[test]
fn names_are_put_together_and_taken_apart() {
    assert_eq!(split(&join("1to5", "cpu")), ("1to5", "cpu"));
    assert_eq!(split(&join("", "cpu")), ("", "cpu"));
}
