use sm2_lossy_link::Profile;

use super::*;

const SECOND: u64 = 1_000_000_000;

/// A message that arrives so many seconds after the start, with an age in microseconds.
fn seen(number: u64, seconds: u64, age_us: u64) -> Seen {
    Seen {
        at: Instant(seconds * SECOND),
        age_ns: age_us * 1_000,
        number,
        damaged: false,
    }
}

fn window(from: u64, to: u64) -> Window {
    let [from, to] = [from, to].map(|seconds| Instant(seconds * SECOND));
    Window { from, to }
}

#[test]
fn a_window_has_its_start_and_not_its_end() {
    let all = [1, 2, 3, 4, 5].map(|second| seen(second, second, 100 * second));
    let window = window(2, 4);
    let numbers = window.of(&all).map(|it| it.number);
    assert_eq!(numbers.collect::<Vec<_>>(), [2, 3]);
    assert_eq!(window.seconds(), 2.0);
    assert_eq!(window.hz(&all), 1.0);
    assert_eq!(window.age(&all, 50), 200_000.0);
    assert_eq!(window.age(&all, 99), 300_000.0);
    assert_eq!((window.hz(&[]), window.age(&[], 99)), (0.0, 0.0));
}

/// A run that is ended before the remote subscriber joins has an empty window.
#[test]
fn an_empty_window_has_no_rate() {
    let all = [seen(1, 2, 1)];
    assert_eq!(window(2, 2).hz(&all), 0.0);
    // The rate is rounded to the hundredth.
    assert_eq!(window(0, 3).hz(&all), 0.33);
}

#[test]
fn messages_between_the_first_and_the_last_one_are_lost() {
    let numbers = |all: &[u64]| Vec::from_iter(all.iter().map(|it| seen(*it, 1, 1)));
    for (all, expected) in [
        (&[][..], 0),
        (&[7], 0),
        (&[7, 8, 9], 0),
        (&[7, 9], 1),
        (&[0, 9], 8),
    ] {
        assert_eq!(lost(&numbers(all)), expected, "{all:?}");
    }
    // The number of a damaged message means nothing.
    let mut all = numbers(&[5, 6, 8]);
    all.push(Seen {
        number: u64::MAX,
        damaged: true,
        ..all[0]
    });
    assert_eq!((lost(&all), damaged(&all)), (1, 1));
    assert_eq!(lost(&all[3..]), 0);
}

#[test]
fn the_report_compares_both_subscribers_before_and_after() {
    let link = LossyLink::relay(Profile::wifi());
    let windows = [window(0, 2), window(2, 4)];
    let local = [
        seen(0, 0, 100),
        seen(1, 1, 200),
        seen(2, 2, 300),
        seen(4, 2, 400),
        seen(5, 3, 500),
    ];
    let mut away = [seen(2, 2, 5_000), seen(5, 3, 9_000)];
    away[0].damaged = true;
    let report = Report::new(1_000_000, &link, windows, &local, &away);
    let json = serde_json::to_value(&report).unwrap();
    let expected = serde_json::json!({
        "local": {
            "hz_before": 1.0, "hz_after": 1.5, "p99_us_before": 200.0, "p99_us_after": 500.0,
            "lost": 1, "damaged": 0,
        },
        "remote": {"hz": 1.0, "goodput_mbit": 8.0, "age_ms": {"p50": 5.0, "p99": 9.0}, "damaged": 1},
        "link": {"rate_mbit": 30.8, "loss_percent": 4.0, "kind": "relay"},
        "interrupted": false,
    });
    assert_eq!(json, expected);
}

#[test]
fn damage_and_no_messages_are_bad_unless_the_run_was_stopped() {
    let link = LossyLink::relay(Profile::wifi());
    let windows = [window(0, 2), window(2, 4)];
    let local = [seen(1, 1, 1), seen(2, 2, 1)];
    let report = |away: &[Seen]| Report::new(16, &link, windows, &local, away);
    let good = report(&[seen(2, 2, 1)]);
    assert_eq!(good.ending(), Ending::Complete);
    let mut damaged = [good.clone(), good.clone()];
    damaged[0].local.damaged = 1;
    damaged[1].remote.damaged = 1;
    let [here, there] = damaged;
    for mut bad in [here, there, report(&[])] {
        assert_eq!(bad.ending(), Ending::Bad);
        bad.interrupted = true;
        assert_eq!(bad.ending(), Ending::Stopped);
    }
}
