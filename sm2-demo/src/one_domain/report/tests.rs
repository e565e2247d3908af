use std::time::Duration;

use super::super::part::Spot;
use super::*;

fn done(part: Part, messages: u64, damaged: u64) -> (Part, Stage) {
    let spot = Spot {
        message: 7,
        offset: 4_096,
    };
    let figures = Figures {
        messages,
        damaged,
        first_damage: (damaged > 0).then_some(spot),
        ..Figures::default()
    };
    (part, Stage::Done(figures))
}

fn failed(part: Part) -> (Part, Stage) {
    (part, Stage::Failed("out of memory".into()))
}

fn outcomes(parts: &[(Part, Stage)]) -> Vec<Outcome<'_>> {
    let figures = |stage: &Stage| match stage {
        Stage::Done(figures) => *figures,
        _ => Figures::default(),
    };
    parts
        .iter()
        .map(|(part, stage)| Outcome {
            part: *part,
            stage,
            figures: figures(stage),
        })
        .collect()
}

fn verdict_of(parts: &[(Part, Stage)]) -> String {
    match verdict(&outcomes(parts)) {
        Ok(()) => "success".into(),
        Err(error) => error.to_string(),
    }
}

const ONE: Part = Part::Subscriber(1);
const TWO: Part = Part::Subscriber(2);

#[test]
fn lost_messages_are_no_failure_and_damaged_ones_are() {
    let publisher = done(Part::Publisher, 300, 0);
    let intact = [done(ONE, 300, 0), done(TWO, 1, 0), publisher.clone()];
    assert_eq!(verdict_of(&intact), "success");
    let damaged = [done(ONE, 300, 0), done(TWO, 300, 2), publisher];
    let expected =
        "subscriber 2 received 2 damaged messages: the first is its message 7, at byte 4096";
    assert_eq!(verdict_of(&damaged), expected);
}

#[test]
fn damage_comes_before_failure_and_failure_before_no_messages() {
    let mut parts = vec![done(ONE, 0, 0), failed(TWO), done(Part::Publisher, 9, 0)];
    assert_eq!(
        verdict_of(&parts),
        "the demo's subscriber 2 failed: out of memory"
    );
    parts.push(done(Part::Subscriber(3), 1, 1));
    assert!(verdict_of(&parts).contains("damaged"));
    let silent = [done(ONE, 0, 0), done(Part::Publisher, 9, 0)];
    assert!(verdict_of(&silent).starts_with("subscriber 1 received nothing"));
    let stuck = [(ONE, Stage::Ready)];
    assert!(verdict_of(&stuck).contains("does not come to an end"));
}

#[test]
fn the_report_counts_what_never_came_as_lost() {
    let parts = [
        done(ONE, 297, 0),
        done(TWO, 300, 0),
        done(Part::Publisher, 300, 0),
    ];
    let total = Total {
        cpu_percent: 12.345,
        pss_bytes: Some(7),
        wall: Duration::from_millis(10_004),
    };
    let report = Report::new(10, true, &outcomes(&parts), total, true);
    let lost: Vec<_> = report.subscribers.iter().map(|it| it.lost).collect();
    assert_eq!((report.published, lost), (300, vec![3, 0]));
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(json["integrity"], "sealed");
    assert_eq!(json["interrupted"], true);
    assert_eq!(json["cpu_percent_total"], 12.35);
    assert_eq!(json["wall_s"], 10.0);
    assert_eq!(json["pss_bytes_total"], 7);
}
