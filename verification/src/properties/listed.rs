//! The checks that are listed beside their engines or in the sources. PROPERTIES.md has no rows for them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::{fs, io};

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::Engine;
use super::check::{Check, Run};
use super::proofs::{Proof, proofs_below};
use crate::mutants::{Catalogue, Mutant};

/// The path of the list of harnesses that angr explores, below the root of the workspace.
const SYMBOLIC: &str = "verification/symbolic/harnesses.toml";

/// The path of the list of loom's models.
const LOOM: &str = "verification/loom-models/counts.txt";

/// The property that a broken variant shows: a model of loom finds it.
const BROKEN: &str = "BITE-LOOM";

/// The lists of checks.
#[derive(Clone, Debug, Default)]
pub struct Listed {
    /// The faults that a check must find.
    pub mutants: Vec<Mutant>,
    /// The models of loom, with those of broken variants.
    pub loom: BTreeSet<String>,
    /// The harnesses that the stand-in runs.
    pub proofs: Vec<Proof>,
    /// Those of them that angr explores, too.
    pub symbolic: BTreeSet<String>,
}

/// `harnesses.toml`: the explored harnesses.
#[derive(Deserialize)]
struct Harnesses {
    quick: BTreeMap<String, IgnoredAny>,
    full: BTreeMap<String, IgnoredAny>,
}

/// The names in a list of models: each line is a number of executions and a name.
#[must_use]
pub fn loom_models(list: &str) -> BTreeSet<String> {
    let lines = list.lines().filter_map(|it| it.split_once(' '));
    let models = lines.filter(|(count, _)| count.parse::<u64>().is_ok());
    models.map(|(_, name)| name.to_owned()).collect()
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
            loom: loom_models(&fs::read_to_string(root.join(LOOM))?),
            proofs: proofs_below(&root.join("sm2-proto/src"), "sm2_proto")?,
            symbolic: quick.into_keys().chain(full.into_keys()).collect(),
        })
    }

    /// The listed checks. A harness that angr explores shows the same as under the stand-in. A model of loom without a
    /// row is that of a broken variant.
    pub(super) fn checks(&self, rows: &[Check]) -> Vec<Check> {
        let check = |engine, harness: &String| Check {
            harness: harness.clone(),
            shows: Vec::new(),
            engine,
            run: Run::Quick,
            strength: None,
            line: None,
        };
        let mutants = self.mutants.iter().map(|it| Check {
            shows: it.properties.clone(),
            run: if it.full { Run::Full } else { Run::Quick },
            ..check(Engine::Mutants, &it.name)
        });
        let proofs = self.proofs.iter().map(|it| Check {
            shows: it.shows.clone(),
            strength: Some(it.strength.clone()),
            ..check(Engine::StandIn, &it.name)
        });
        let symbolic = self.symbolic.iter().map(|harness| {
            let proof = self.proofs.iter().find(|it| it.name == *harness);
            Check {
                shows: proof.map_or_else(Vec::new, |it| it.shows.clone()),
                run: Run::Full,
                ..check(Engine::Angr, harness)
            }
        });
        let has_no_row = |name: &&String| {
            let mut rows = rows.iter();
            !rows.any(|it| it.engine == Engine::Loom && it.harness == **name)
        };
        let broken = self.loom.iter().filter(has_no_row).map(|it| Check {
            shows: vec![BROKEN.to_owned()],
            ..check(Engine::Loom, it)
        });
        let listed = mutants.chain(proofs).chain(symbolic);
        listed.chain(broken).collect()
    }
}
