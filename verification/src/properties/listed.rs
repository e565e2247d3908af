//! The checks that are listed beside their engines. PROPERTIES.md has no rows for them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::{fs, io};

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::Engine;
use super::check::{Check, Run};
use crate::mutants::{Catalogue, Mutant};

/// The path of the list of harnesses that angr explores, below the root of the workspace.
const SYMBOLIC: &str = "verification/symbolic/harnesses.toml";

/// The lists of checks.
#[derive(Clone, Debug, Default)]
pub struct Listed {
    /// The faults that a check must find.
    pub mutants: Vec<Mutant>,
    /// The harnesses of the stand-in that angr explores, too.
    pub symbolic: BTreeSet<String>,
}

/// `harnesses.toml`: the explored harnesses.
#[derive(Deserialize)]
struct Harnesses {
    quick: BTreeMap<String, IgnoredAny>,
    full: BTreeMap<String, IgnoredAny>,
}

impl Listed {
    /// Reads the lists of the workspace at `root`.
    ///
    /// # Errors
    /// A list is missing or invalid.
    pub fn load(root: &Path) -> io::Result<Self> {
        let catalogue = Catalogue::load(root).map_err(io::Error::other)?;
        let text = fs::read_to_string(root.join(SYMBOLIC))?;
        let harnesses: Harnesses = toml::from_str(&text).map_err(io::Error::other)?;
        let Harnesses { quick, full } = harnesses;
        Ok(Self {
            mutants: catalogue.mutants,
            symbolic: quick.into_keys().chain(full.into_keys()).collect(),
        })
    }

    /// The listed checks. A harness that angr explores shows what the row of the stand-in among `rows` says; without
    /// such a row it shows nothing.
    pub(super) fn checks(&self, rows: &[Check]) -> Vec<Check> {
        let mutants = self.mutants.iter().map(|it| Check {
            harness: it.name.clone(),
            shows: it.properties.clone(),
            engine: Engine::Mutants,
            run: if it.full { Run::Full } else { Run::Quick },
            strength: None,
            line: None,
        });
        let symbolic = self.symbolic.iter().map(|harness| {
            let mut rows = rows.iter().filter(|it| it.engine == Engine::StandIn);
            let row = rows.find(|it| it.harness == *harness);
            Check {
                harness: harness.clone(),
                shows: row.map_or_else(Vec::new, |it| it.shows.clone()),
                engine: Engine::Angr,
                run: Run::Full,
                strength: None,
                line: None,
            }
        });
        mutants.chain(symbolic).collect()
    }
}
