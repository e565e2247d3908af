use super::{Durations, Spread, Summary, summary};

fn durations(all: impl IntoIterator<Item = u64>) -> Durations {
    let mut durations = Durations::default();
    all.into_iter().for_each(|ns| durations.record(ns));
    durations
}

#[test]
fn the_median_is_the_middle_one_whatever_the_order() {
    let expected = Summary {
        median: 2.0,
        min: 1.0,
        max: 9.0,
    };
    assert_eq!(summary(&[9.0, 1.0, 2.0]), Some(expected));
}

#[test]
fn of_an_even_number_the_median_is_between_the_two_in_the_middle() {
    assert_eq!(summary(&[4.0, 1.0, 2.0, 100.0]).unwrap().median, 3.0);
}

#[test]
fn nothing_is_said_about_no_runs() {
    assert_eq!(summary(&[]), None);
    assert_eq!(Durations::default().spread(), Spread::default());
}

#[test]
fn percentiles_are_durations_that_were_there() {
    let spread = durations((1..=150).rev()).spread();
    assert_eq!((spread.count, spread.p50, spread.p99), (150, 75.0, 149.0));
    assert_eq!((spread.mean, spread.max), (75.5, 150.0));
}

#[test]
fn one_duration_is_all_percentiles() {
    let spread = durations([7]).spread();
    assert_eq!((spread.p50, spread.p99, spread.mean), (7.0, 7.0, 7.0));
}

#[test]
fn what_was_forgotten_does_not_count() {
    let mut some = durations([1, 2, 3]);
    some.clear();
    some.record(50);
    let spread = some.spread();
    assert_eq!((spread.count, spread.mean), (1, 50.0));
}
