//! The checks that are listed beside their engines or in the sources. PROPERTIES.md has no rows for them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::{fs, io};

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::Engine;
use super::check::{Check, Run};
use super::claims::{Place, checks_in};
use super::proofs::{Proof, proofs_below};
use crate::mutants::{Catalogue, Mutant};

/// The path of the list of harnesses that angr explores, below the root of the workspace.
const SYMBOLIC: &str = "verification/symbolic/harnesses.toml";

/// The path of the list of loom's models.
const LOOM: &str = "verification/loom-models/counts.txt";

/// The sources whose comments say what their checks show, besides the folders `tests` of all packages.
const COMMENTED: [(&str, Place); 5] = [
    ("fuzz/fuzz_targets", Place::Stem),
    ("verification/loom-models/tests", Place::Code),
    ("verification/src/model/domain/scope.rs", Place::Code),
    ("verification/src/model/link/scope.rs", Place::Code),
    ("verification/src/model/lockstep/scope.rs", Place::Code),
];

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
    /// Tests, fuzz targets and models, which comments describe.
    pub commented: Vec<Check>,
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
            commented: commented(root)?,
        })
    }

    /// The listed checks. A harness that angr explores shows the same as under the stand-in. A model of loom without a
    /// comment is that of a broken variant.
    pub(super) fn checks(&self) -> Vec<Check> {
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
        let has_no_comment = |name: &&String| {
            let mut commented = self.commented.iter();
            !commented.any(|it| it.engine == Engine::Loom && it.harness == **name)
        };
        let broken = self.loom.iter().filter(has_no_comment).map(|it| Check {
            shows: vec![BROKEN.to_owned()],
            ..check(Engine::Loom, it)
        });
        let listed = mutants.chain(proofs).chain(symbolic).chain(broken);
        listed.chain(self.commented.iter().cloned()).collect()
    }
}

/// The checks that comments describe.
fn commented(root: &Path) -> io::Result<Vec<Check>> {
    let mut packages = Vec::new();
    for entry in fs::read_dir(root)? {
        packages.push(entry?.file_name().to_string_lossy().into_owned());
    }
    packages.sort();
    let tests = packages.iter().map(|it| format!("{it}/tests"));
    let tests = tests.filter(|it| root.join(it).is_dir());
    let mut found = Vec::new();
    for folder in tests {
        found.extend(checks_in(root, &folder, Place::File)?);
    }
    for (path, place) in COMMENTED {
        found.extend(checks_in(root, path, place)?);
    }
    Ok(found)
}
