use super::*;
use crate::one_domain::report::Subscriber;
use crate::statistics::Percentiles;

/// The output of a screen: an announcement, the costs of the Manager in two seconds, and the report.
fn written(format: Format) -> [String; 4] {
    let mut out = Vec::new();
    let mut ends = [0; 4];
    let meter = Meter::start(Vec::new());
    let report = Report {
        published: 9,
        size_bytes: 16,
        integrity: "pooled",
        interrupted: false,
        subscribers: vec![Subscriber {
            received: 9,
            lost: 0,
            damaged: 0,
            hz: 1.0,
            latency_us: Percentiles::default(),
        }],
        cpu_percent_total: 1.0,
        pss_bytes_total: None,
        wall_s: 1.0,
    };
    let costs = [Cost::default()];
    let mut screen = Screen::new(&mut out, format);
    screen.announce("begins").unwrap();
    screen.show(&[], &meter, &costs).unwrap();
    screen.show(&[], &meter, &costs).unwrap();
    screen.report(&report).unwrap();
    let text = String::from_utf8(out).unwrap();
    // The announcement ends with its line, and each table with the line of the sums.
    let mut at = 0;
    for (end, last) in ends.iter_mut().zip(["begins", "\ntogether", "\ntogether"]) {
        let found = text[at..].find(last).map(|it| at + it + last.len());
        at = found.map_or(at, |it| it + text[it..].find('\n').unwrap() + 1);
        *end = at;
    }
    ends[3] = text.len();
    let [first, second, third, last] = ends;
    [0..first, first..second, second..third, third..last].map(|it| text[it].to_owned())
}

#[test]
fn a_terminal_shows_one_table_that_is_redrawn() {
    let [announced, first, second, report] = written(Format::Terminal);
    assert_eq!(announced, "begins\n");
    // The heading, the Manager, and the sums.
    assert_eq!(first.lines().count(), 3, "{first}");
    let erase = "\x1b[3A\x1b[J";
    assert_eq!(second, format!("{erase}{first}"));
    let summary = report.strip_prefix(erase).unwrap();
    assert_eq!(summary.lines().count(), 3, "{summary}");
    assert!(!summary.contains('\x1b'), "{summary}");
}

#[test]
fn a_file_has_a_line_each_second() {
    let [announced, _, _, rest] = written(Format::Lines);
    assert_eq!(announced, "begins\n");
    assert!(!rest.contains('\x1b'), "{rest}");
    let lines = Vec::from_iter(rest.lines());
    assert_eq!(lines.len(), 2 + 3, "{rest}");
    assert!(
        lines[..2].iter().all(|it| it.contains(" Hz  p50 ")),
        "{rest}"
    );
}

#[test]
fn json_is_the_report_alone() {
    let [.., all] = written(Format::Json);
    assert_eq!(all.lines().count(), 1, "{all}");
    let json: serde_json::Value = serde_json::from_str(&all).unwrap();
    assert_eq!(json["published"], 9);
}

/// A table that does not fit a terminal would scroll it instead of being redrawn.
#[test]
fn a_long_table_is_a_line() {
    let mut out = Vec::new();
    let mut screen = Screen::new(&mut out, Format::Terminal);
    for (lines, drawn) in [(REDRAWN_LINES, REDRAWN_LINES), (REDRAWN_LINES + 1, 0)] {
        screen.drawn = 0;
        // The heading and the sums are lines, too.
        let rows = vec![
            Row {
                part: None,
                cost: Cost::default()
            };
            lines - 2
        ];
        screen.show_rows(Duration::from_secs(1), &rows).unwrap();
        assert_eq!(screen.drawn, drawn, "{lines}");
    }
}
