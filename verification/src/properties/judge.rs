//! Compares rows with the results of a run.

use std::collections::{BTreeMap, BTreeSet};

use super::{Check, Engine, Gap, GapKind, Outcome, Register, Run, expected};

/// The part of its checks that an engine ran.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Extent {
    /// It ran all of its checks: each of its rows must have an outcome.
    Ran,
    /// It ran the checks of a quick run. The set has the names of all of its checks.
    RanQuick(BTreeSet<String>),
    /// It cannot run here, was not selected, or failed: a missing outcome is not a gap.
    Partly,
}

/// The engines and checks of a run.
#[derive(Clone, Debug, Default)]
pub struct RunResults {
    /// The part that each engine ran; engines that were not selected have no entry.
    pub engines: BTreeMap<Engine, Extent>,
    /// The selected rows; `None` for all.
    pub only: Option<BTreeSet<(Engine, String)>>,
    /// The reported outcomes.
    pub outcomes: Vec<Outcome>,
    /// The number of tests that the source of each file of tests has.
    pub tests: BTreeMap<String, u64>,
}

impl RunResults {
    /// The disagreements between rows and run. A failed check is not a gap: its verdict reports it.
    #[must_use]
    pub fn gaps(&self, register: &Register) -> Vec<Gap> {
        let rows = register.checks().iter().filter(|it| self.asked(it));
        let mut gaps: Vec<_> = rows.filter_map(|row| self.gap(row)).collect();
        for outcome in &self.outcomes {
            let (engine, harness) = (outcome.engine, outcome.harness.clone());
            if register.check(engine, &harness).is_none() {
                let kind = GapKind::NoRow { engine, harness };
                gaps.push(Gap { line: None, kind });
            }
        }
        gaps
    }

    fn asked(&self, row: &Check) -> bool {
        let key = (row.engine, row.harness.clone());
        self.only.as_ref().is_none_or(|only| only.contains(&key))
    }

    fn gap(&self, row: &Check) -> Option<Gap> {
        let (engine, harness) = (row.engine, row.harness.clone());
        let is_it = |it: &&Outcome| it.engine == engine && it.harness == harness;
        if let Some(outcome) = self.outcomes.iter().find(is_it) {
            let tests = self.tests.get(&harness).copied();
            let wanted = expected::unmet(row, &outcome.covered, tests).filter(|_| outcome.held);
            return wanted.map(|wanted| {
                let now = outcome.covered.clone();
                row.gap(GapKind::Less {
                    engine,
                    harness,
                    wanted,
                    now,
                })
            });
        }
        match self.engines.get(&engine)? {
            Extent::Partly => None,
            Extent::RanQuick(listed) if row.run == Run::Full => {
                let is_listed = listed.contains(&harness);
                (!is_listed).then(|| row.gap(GapKind::Unlisted { engine, harness }))
            }
            Extent::Ran | Extent::RanQuick(_) => Some(row.gap(GapKind::Silent { engine, harness })),
        }
    }
}
