use super::super::report::Subscriber;
use super::*;
use crate::statistics::Percentiles;

fn figures(hz: f64, p99: f64, lost: u64) -> Figures {
    Figures {
        messages: 1_000_000,
        lost,
        damaged: 3,
        hz,
        latency_us: Percentiles {
            p50: 321.4,
            p99,
            max: 99_999.9,
        },
        ..Figures::default()
    }
}

fn rows() -> Vec<Row> {
    let cost = Cost {
        cpu_percent: 12.34,
        pss_bytes: Some(10_500_000),
    };
    let row = |part| Row { part, cost };
    vec![
        row(Some((Part::Publisher, figures(30.0, 0.0, 0)))),
        row(Some((Part::Subscriber(1), figures(30.0, 500.0, 1)))),
        row(Some((Part::Subscriber(64), figures(29.5, 700.0, 2)))),
        row(None),
    ]
}

#[test]
fn a_table_has_a_line_for_each_process_and_their_sum() {
    let table = table(&rows());
    let starts: Vec<_> = table.iter().map(|line| line[..14].trim_end()).collect();
    let expected = [
        "",
        "publisher",
        "subscriber 1",
        "subscriber 64",
        "Manager",
        "together",
    ];
    assert_eq!(starts, expected);
    assert!(
        table[5].contains("49.4") && table[5].ends_with("42.0"),
        "{table:#?}"
    );
    assert!(
        table.iter().all(|line| line.chars().count() <= 79),
        "{table:#?}"
    );
}

#[test]
fn a_line_shows_the_slowest_and_the_sums() {
    let line = line(Duration::from_secs(7), &rows());
    let expected = "   7 s  29.5 Hz  p50 321 us  p99 700 us  lost 3  damaged 6  \
                    CPU 49.4 %  PSS 42.0 MB";
    assert_eq!(line, expected);
}

#[test]
fn a_summary_has_a_line_for_each_subscriber() {
    let report = Report {
        published: 300,
        size_bytes: 10_000_000,
        integrity: "pooled",
        interrupted: false,
        subscribers: vec![Subscriber {
            received: 299,
            lost: 1,
            damaged: 0,
            hz: 29.97,
            latency_us: figures(0.0, 900.0, 0).latency_us,
        }],
        cpu_percent_total: 20.0,
        pss_bytes_total: None,
        wall_s: 10.0,
    };
    let summary = summary(&report);
    assert_eq!(summary.len(), 3);
    assert!(summary[1].starts_with("subscriber 1"), "{summary:#?}");
    assert!(summary[1].ends_with("99999.9"), "{summary:#?}");
    assert!(summary[2].contains("300 messages of 10 MB"), "{summary:#?}");
    assert!(summary[2].contains("PSS unknown"), "{summary:#?}");
}

#[test]
fn what_was_not_measured_is_a_dash() {
    let silent = Figures::default();
    let rows = [Row {
        part: Some((Part::Subscriber(1), silent)),
        cost: Cost::default(),
    }];
    let line = line(Duration::from_secs(1), &rows);
    assert!(line.contains("p50 - us  p99 - us"), "{line}");
    let table = table(&rows);
    let cells: Vec<_> = table[1].split_whitespace().collect();
    assert_eq!(cells[2..6], ["0", "0.0", "-", "-"], "{table:#?}");
}
