//! Paths through a harness: recorded choices, then samples.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::panic::{self, AssertUnwindSafe};

/// How far a run goes, and what it has to meet.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The most paths depth first.
    pub paths: u64,
    /// How many samples follow where these were not all.
    pub samples: u64,
    /// The number of `cover!` in the harness: each has to be hit.
    pub covers: usize,
    /// Where the samples begin.
    pub seed: u64,
}

impl Limits {
    /// Limits that take about a second in a debug build.
    #[must_use]
    pub const fn new(covers: usize) -> Self {
        Self {
            paths: 70_000,
            samples: 20_000,
            covers,
            seed: 1,
        }
    }
}

/// How the paths were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// All there are.
    Exhaustive,
    /// Every combination of boundary values, then samples.
    BoundariesAndSamples,
    /// The first ones, then samples: there are too many.
    Samples,
}

/// Why a run shows nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The harness asked for no value.
    NothingChosen,
    /// `assume` gave up every path.
    AllRejected,
    /// Not as many covers were hit as the harness has.
    Uncovered,
}

/// What a run did.
#[derive(Clone, Debug)]
pub struct Report {
    /// How paths were found.
    pub mode: Mode,
    /// Paths run, rejected ones included.
    pub paths: u64,
    /// Paths that `assume` gave up.
    pub rejected: u64,
    /// How often each cover held, among those that were reached.
    pub covers: BTreeMap<&'static str, u64>,
    chosen: bool,
}

impl Report {
    /// Whether the run shows anything.
    pub fn verdict(&self, limits: &Limits) -> Result<(), Failure> {
        let hit = self.covers.values().filter(|hits| **hits > 0).count();
        if !self.chosen {
            Err(Failure::NothingChosen)
        } else if self.rejected == self.paths {
            Err(Failure::AllRejected)
        } else if hit != limits.covers || hit != self.covers.len() {
            Err(Failure::Uncovered)
        } else {
            Ok(())
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            mode,
            paths,
            rejected,
            covers,
            ..
        } = self;
        write!(f, "{mode:?}, {paths} paths, {rejected} rejected")?;
        covers
            .iter()
            .try_for_each(|(cover, hits)| write!(f, "\n    {hits} x {cover}"))
    }
}

#[derive(Default)]
struct State {
    /// The choices of this path, each with the number of its alternatives.
    path: Vec<(u64, u64)>,
    at: usize,
    /// The generator of samples; none while paths go depth first.
    random: Option<u64>,
    /// Of 16 choices of this sample, how many are 0: deep paths often need many of them.
    zeros: u64,
    lossy: bool,
    chosen: bool,
    covers: BTreeMap<&'static str, u64>,
}

thread_local!(static STATE: RefCell<State> = RefCell::default());

struct Rejected;

fn with<R>(f: impl FnOnce(&mut State) -> R) -> R {
    STATE.with(|state| f(&mut state.borrow_mut()))
}

/// SplitMix64.
fn next(seed: &mut u64) -> u64 {
    *seed = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut mixed = *seed;
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}

impl State {
    fn choose(&mut self, alternatives: u64) -> u64 {
        self.chosen = true;
        if let Some(seed) = &mut self.random {
            let choice = match next(seed) % 16 {
                draw if draw < self.zeros => 0,
                draw if draw % 2 == 0 => next(seed) % alternatives.min(16),
                _ => next(seed) % alternatives,
            };
            self.path.push((choice, alternatives));
            return choice;
        }
        if self.at == self.path.len() {
            self.path.push((0, alternatives));
        }
        let (choice, before) = self.path[self.at];
        assert_eq!(before, alternatives, "the harness is not deterministic");
        self.at += 1;
        choice
    }

    /// Makes `path` the next one; false after the last.
    fn advance(&mut self) -> bool {
        self.path.truncate(self.at);
        while let Some((choice, alternatives)) = self.path.pop() {
            if choice + 1 < alternatives {
                self.path.push((choice + 1, alternatives));
                return true;
            }
        }
        false
    }
}

/// Any of `0..alternatives`; all else is made of it.
#[must_use]
pub fn choose(alternatives: u64) -> u64 {
    with(|state| state.choose(alternatives))
}

/// An integer too wide to go through: boundary values, or a sample.
pub(crate) fn wide(bits: u32) -> u128 {
    with(|state| {
        state.chosen = true;
        state.lossy = true;
        let mask = u128::MAX >> (128 - bits);
        let draw = state
            .random
            .as_mut()
            .map(|seed| (next(seed) % 4, next(seed)));
        let value = match draw {
            Some((0, draw)) => {
                let bits_set = 1 + draw % u64::from(bits);
                u128::from(draw).wrapping_mul(0x9E37_79B9_7F4A_7C15_F39C_C060_5CED_C835)
                    >> (128 - bits_set)
            }
            Some((1, draw)) => 4_096 * u128::from(draw % 4_096),
            _ => match state.choose(10) {
                0 => 0,
                1 => 1,
                2 => 2,
                3 => 4_096,
                4 => 1 << (bits / 2),
                5 => 1 << (bits - 1),
                6 => u128::MAX - 1,
                7 => (1 << 16) + 1,
                8 => 512,
                _ => u128::MAX,
            },
        };
        value & mask
    })
}

pub(crate) fn assume(condition: bool) {
    if !condition {
        panic::resume_unwind(Box::new(Rejected));
    }
}

/// Counts a cover.
pub fn covered(cover: &'static str, holds: bool) {
    with(|state| *state.covers.entry(cover).or_default() += u64::from(holds));
}

/// Runs a harness along its paths.
///
/// # Panics
///
/// As the harness does, after its choices were printed.
pub fn run(limits: &Limits, harness: impl Fn()) -> Report {
    with(|state| *state = State::default());
    let (mut paths, mut rejected) = (0, 0);
    let mut path = || {
        paths += 1;
        if let Err(cause) = panic::catch_unwind(AssertUnwindSafe(&harness)) {
            if !cause.is::<Rejected>() {
                with(|state| eprintln!("choices (value, alternatives): {:?}", state.path));
                panic::resume_unwind(cause);
            }
            rejected += 1;
        }
    };
    let mut complete = false;
    for _ in 0..limits.paths {
        with(|state| state.at = 0);
        path();
        if !with(State::advance) {
            complete = true;
            break;
        }
    }
    let mode = match (complete, with(|state| state.lossy)) {
        (true, false) => Mode::Exhaustive,
        (true, true) => Mode::BoundariesAndSamples,
        (false, _) => Mode::Samples,
    };
    if mode != Mode::Exhaustive {
        for sample in 0..limits.samples {
            with(|state| {
                state.path.clear();
                state.random = Some(limits.seed.wrapping_add(sample << 20));
                state.zeros = 5 * (sample % 4);
            });
            path();
        }
    }
    with(|state| Report {
        mode,
        paths,
        rejected,
        covers: std::mem::take(&mut state.covers),
        chosen: state.chosen,
    })
}

/// Runs a harness and prints what the run covered.
///
/// # Panics
///
/// As the harness does, and if the run shows nothing: see [`Failure`].
pub fn explore(name: &str, limits: &Limits, harness: impl Fn()) {
    let report = run(limits, harness);
    println!("{name}: {report}");
    if let Err(failure) = report.verdict(limits) {
        panic!("{name} shows nothing: {failure:?}");
    }
}

#[cfg(test)]
mod tests {
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
        let report = run(&Limits::new(0), || {
            any_where(|byte: &u8| *byte < 6);
        });
        assert_eq!((report.paths, report.rejected), (256, 250));
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
}
