//! Paths through a harness: first depth first over recorded choices, then samples.

#[cfg(test)]
mod tests;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::panic::{self, AssertUnwindSafe};

use crate::results;

/// The limits of a run, and the number of covers that it must hit.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The greatest number of paths that are run depth first.
    pub paths: u64,
    /// The number of samples that follow if these were not all paths.
    pub samples: u64,
    /// The number of `cover!` in the harness: each has to be hit.
    pub covers: usize,
    /// The seed of the samples.
    pub seed: u64,
}

impl Limits {
    /// Limits that take about a second in a debug build.
    #[must_use]
    pub const fn new(covers: usize) -> Self {
        Self {
            paths: 80_000,
            samples: 20_000,
            covers,
            seed: 1,
        }
    }
}

/// How the paths were chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// All paths were run.
    Exhaustive,
    /// Every combination of boundary values, then samples.
    BoundariesAndSamples,
    /// The first paths depth first, then samples, because there are too many.
    Samples,
}

/// Why a run is not evidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The harness requested no value.
    NothingChosen,
    /// `assume` abandoned every path.
    AllRejected,
    /// Fewer covers were hit than the harness has.
    Uncovered,
}

/// The result of a run.
#[derive(Clone, Debug)]
pub struct Report {
    /// How the paths were chosen.
    pub mode: Mode,
    /// Paths run, rejected ones included.
    pub paths: u64,
    /// Paths that `assume` abandoned.
    pub rejected: u64,
    /// How often each cover that was reached held.
    pub covers: BTreeMap<&'static str, u64>,
    chosen: bool,
}

impl Report {
    /// Describes the coverage in a few words.
    #[must_use]
    pub fn covered(&self) -> String {
        let Self {
            mode,
            paths,
            rejected,
            ..
        } = self;
        format!("{mode:?}, {paths} paths, {rejected} rejected")
    }

    /// Checks that the run is evidence.
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
        f.write_str(&self.covered())?;
        self.covers
            .iter()
            .try_for_each(|(cover, hits)| write!(f, "\n    {hits} x {cover}"))
    }
}

/// A choice among several alternatives.
struct Choice {
    value: u64,
    alternatives: u64,
    /// The values of the choices, if they are a subset of the numbers below 256.
    legal: Vec<u8>,
}

#[derive(Default)]
struct State {
    /// The choices of this path.
    path: Vec<Choice>,
    at: usize,
    /// The generator of samples; `None` while paths are run depth first.
    random: Option<u64>,
    /// How many of 16 choices of this sample are 0, because deep paths often need many zeros.
    zeros: u64,
    lossy: bool,
    sixteen: Sixteen,
    chosen: bool,
    covers: BTreeMap<&'static str, u64>,
}

/// The values of 16 bits that are chosen from.
#[derive(Default, PartialEq, Eq)]
enum Sixteen {
    /// None was requested so far.
    #[default]
    Unused,
    All,
    /// Boundary values, because all values were too many.
    Boundaries,
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
            let value = match next(seed) % 16 {
                draw if draw < self.zeros => 0,
                draw if draw % 2 == 0 => next(seed) % alternatives.min(16),
                _ => next(seed) % alternatives,
            };
            self.push(value, alternatives);
            return value;
        }
        if self.at == self.path.len() {
            self.push(0, alternatives);
        }
        let choice = &self.path[self.at];
        assert_eq!(
            choice.alternatives, alternatives,
            "the harness is not deterministic"
        );
        self.at += 1;
        choice.value
    }

    fn push(&mut self, value: u64, alternatives: u64) {
        self.path.push(Choice {
            value,
            alternatives,
            legal: Vec::new(),
        });
    }

    /// Returns the value of the next choice, if this path shares it with the previous path.
    fn again(&mut self) -> Option<u8> {
        if self.random.is_some() {
            return None;
        }
        let choice = self.path.get(self.at)?;
        let legal = choice.legal.get(choice.value as usize);
        self.at += usize::from(legal.is_some());
        legal.copied()
    }

    fn choices(&self) -> String {
        let choices = self.path.iter().map(|it| {
            let value = it.legal.get(it.value as usize).copied();
            (value.map_or(it.value, u64::from), it.alternatives)
        });
        format!("{:?}", choices.collect::<Vec<_>>())
    }

    /// Chooses one of the boundary values.
    fn boundary(&mut self, values: &[u64]) -> u64 {
        self.lossy = true;
        let at = self.choose(values.len() as u64);
        values[at as usize]
    }

    /// Starts again with boundary values for 16 bits. Returns false if none were requested.
    fn coarsen(&mut self) -> bool {
        self.path.clear();
        if self.sixteen == Sixteen::Unused {
            return false;
        }
        self.sixteen = Sixteen::Boundaries;
        true
    }

    /// Advances `path` to the next path. Returns false after the last.
    fn advance(&mut self) -> bool {
        self.path.truncate(self.at);
        while let Some(choice) = self.path.last_mut() {
            choice.value += 1;
            if choice.value < choice.alternatives {
                return true;
            }
            self.path.pop();
        }
        false
    }
}

/// Chooses a number in `0..alternatives`. All other choices are made of such choices.
#[must_use]
pub fn choose(alternatives: u64) -> u64 {
    with(|state| state.choose(alternatives))
}

/// Chooses a number below 256 that `holds` accepts. Calls `holds` once for each choice,
/// not for each path.
pub(crate) fn choose_where(holds: impl Fn(u8) -> bool) -> u8 {
    if let Some(value) = with(State::again) {
        return value;
    }
    let legal: Vec<u8> = (0..=u8::MAX).filter(|value| holds(*value)).collect();
    with(|state| state.chosen = true);
    assume(!legal.is_empty());
    with(|state| {
        let at = state.choose(legal.len() as u64);
        let value = legal[at as usize];
        if let Some(choice) = state.path.last_mut() {
            choice.legal = legal;
        }
        value
    })
}

/// Chooses a value of 16 bits: any value, unless that makes too many paths.
pub(crate) fn sixteen() -> u64 {
    with(|state| {
        if state.sixteen == Sixteen::Unused {
            state.sixteen = Sixteen::All;
        }
        let coarse = match &mut state.random {
            Some(seed) => next(seed).is_multiple_of(2),
            None => state.sixteen == Sixteen::Boundaries,
        };
        if coarse {
            state.boundary(&SIXTEEN)
        } else {
            state.choose(1 << 16)
        }
    })
}

/// Values around those limits of SPEC that fit in 16 bits, and the ends of the range.
const SIXTEEN: [u64; 18] = [
    0, 1, 2, 3, 255, 256, 511, 512, 513, 1_023, 1_024, 1_025, 2_048, 2_049, 32_767, 32_768, 65_534,
    65_535,
];

/// Chooses an integer too wide to enumerate: a boundary value, or a sample.
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
            _ => match state.choose(14) {
                0 => 0,
                1 => 1,
                2 => 2,
                3 => 4_096,
                4 => 1 << (bits / 2),
                5 => 1 << (bits - 1),
                6 => u128::MAX - 1,
                7 => (1 << 16) + 1,
                8 => 512,
                9 => 1_024,
                10 => 1_025,
                11 => (1 << 16) - 1,
                12 => 1 << 16,
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
/// As the harness does, after printing its choices.
pub fn run(limits: &Limits, harness: impl Fn()) -> Report {
    with(|state| *state = State::default());
    let (mut paths, mut rejected) = (0, 0);
    let mut path = || {
        paths += 1;
        if let Err(cause) = panic::catch_unwind(AssertUnwindSafe(&harness)) {
            if !cause.is::<Rejected>() {
                with(|state| eprintln!("choices (value, alternatives): {}", state.choices()));
                panic::resume_unwind(cause);
            }
            rejected += 1;
        }
    };
    let mut depth_first = || {
        for _ in 0..limits.paths {
            with(|state| state.at = 0);
            path();
            if !with(State::advance) {
                return true;
            }
        }
        false
    };
    let mut complete = depth_first();
    if !complete && with(State::coarsen) {
        complete = depth_first();
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

/// Runs a harness, prints what the run covered, and appends it to the results, if these are
/// requested.
///
/// # Panics
///
/// As the harness does, and if the run is not evidence: see [`Failure`].
pub fn explore(test: &str, limits: &Limits, harness: impl Fn()) {
    // `explored!` puts the tests in a separate module.
    let name = &test.replace("::explored::", "::");
    let begin = std::time::Instant::now();
    let report = panic::catch_unwind(AssertUnwindSafe(|| run(limits, harness)));
    let covered = match &report {
        Ok(report) => report.verdict(limits).map(|()| report.covered()).ok(),
        Err(_) => None,
    };
    results::append(name, covered.as_deref(), begin.elapsed());
    let report = report.unwrap_or_else(|cause| panic::resume_unwind(cause));
    println!("{name}: {report}");
    if let Err(failure) = report.verdict(limits) {
        panic!("{name} shows nothing: {failure:?}");
    }
}
