//! Tests of the coverage of a run, and of runs that are not evidence.

use super::*;
use crate::{any, any_where};

fn verdict(covers: usize, harness: impl Fn()) -> Result<(), Failure> {
    let limits = Limits::new(covers);
    run(&limits, harness).verdict(&limits)
}

#[test]
fn goes_through_a_small_tree() {
    let report = run(&Limits::new(0), || {
        let (_, wide): (bool, bool) = any();
        if wide {
            let _: u8 = any();
        }
    });
    assert_eq!(report.mode, Mode::Exhaustive);
    assert_eq!(report.paths, 2 + 2 * 256);
    assert_eq!(report.rejected, 0);
}

#[test]
fn samples_what_is_wide() {
    let report = run(&Limits::new(0), || crate::assume(any::<u64>() > 0));
    assert_eq!(report.mode, Mode::BoundariesAndSamples);
    let report = run(&Limits::new(0), || {
        crate::assume(any::<[u8; 3]>() != [0; 3])
    });
    assert_eq!(report.mode, Mode::Samples);
}

#[test]
fn counts_rejected_paths() {
    let report = run(&Limits::new(0), || crate::assume(any::<u8>() < 6));
    assert_eq!((report.paths, report.rejected), (256, 250));
}

#[test]
fn tries_no_narrow_value_in_vain() {
    let report = run(&Limits::new(0), || {
        assert!(any_where(|byte: &u8| byte % 50 == 3) % 50 == 3);
    });
    assert_eq!((report.paths, report.rejected), (6, 0));
    assert_eq!(report.mode, Mode::Exhaustive);
    let none = verdict(0, || assert!(any_where(|_: &i8| false) == 0));
    assert_eq!(none, Err(Failure::AllRejected));
}

#[test]
fn two_times_16_bits_are_boundary_values_and_samples() {
    let one = run(&Limits::new(0), || crate::assume(any::<u16>() > 0));
    assert_eq!((one.mode, one.paths), (Mode::Exhaustive, 65_536));
    let limits = Limits::new(1);
    let two = run(&limits, || {
        let (one, other): (u16, u16) = any();
        crate::cover!(one == 1_025 && other == 65_535, "both at a boundary");
    });
    assert_eq!(two.mode, Mode::BoundariesAndSamples);
    assert_eq!(two.paths, limits.paths + 18 * 18 + limits.samples);
    assert_eq!(two.verdict(&limits), Ok(()));
}

#[test]
#[should_panic(expected = "seven")]
fn finds_the_one_bad_value() {
    run(&Limits::new(0), || crate::assert(any::<u8>() != 7, "seven"));
}

#[test]
fn fails_when_all_is_rejected() {
    let all = verdict(0, || crate::assume(u16::from(any::<u8>()) == 256));
    assert_eq!(all, Err(Failure::AllRejected));
}

#[test]
fn fails_when_a_cover_is_not_hit_or_not_reached() {
    let never = verdict(1, || {
        crate::cover!(u16::from(any::<u8>()) == 256, "no byte")
    });
    assert_eq!(never, Err(Failure::Uncovered));
    let unreached = verdict(1, || {
        if any::<u8>() > 254 && any_where(|_: &bool| false) {
            crate::cover!(true, "nobody comes here");
        }
    });
    assert_eq!(unreached, Err(Failure::Uncovered));
    assert_eq!(verdict(1, || crate::cover!(any::<bool>(), "half")), Ok(()));
}

#[test]
fn fails_when_nothing_is_chosen() {
    assert_eq!(verdict(0, || ()), Err(Failure::NothingChosen));
}
