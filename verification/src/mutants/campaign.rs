//! Makes the mutants, one after the other, in a copy of the workspace.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Instant,
};

use super::{
    Check, Killed, Mutant, MutantsError, Outcome, Verdict,
    check::{Cargo, Programs, Ran, Target, Unit},
    tree::Tree,
};

/// A run of mutants. Only one at a time can use a folder for build output.
#[derive(Debug)]
pub struct Campaign<'a> {
    tree: Tree,
    cargo: Cargo,
    mutants: &'a [&'a Mutant],
    /// The checks that fail without a mutant, and their messages.
    broken: Vec<(&'a Check, String)>,
}

impl<'a> Campaign<'a> {
    /// Copies the workspace at `root` into `output`, which keeps builds for the next run, and runs every
    /// check there without a mutant.
    ///
    /// # Errors
    ///
    /// A file cannot be copied, or the checks cannot be built or run at all.
    pub fn new(
        root: &Path,
        output: &Path,
        mutants: &'a [&'a Mutant],
    ) -> Result<Self, MutantsError> {
        let work = output.join("mutants");
        let tree = Tree::copy(root, &work.join("tree"))?;
        let root = tree.root().to_owned();
        let mut campaign = Self {
            tree,
            cargo: Cargo { root, work },
            mutants,
            broken: Vec::new(),
        };
        campaign.broken = campaign.broken()?;
        Ok(campaign)
    }

    /// Runs each mutant against its check, and passes each outcome to `each`.
    ///
    /// # Errors
    ///
    /// A check cannot be run.
    pub fn run(&self, mut each: impl FnMut(&Outcome)) -> Result<(), MutantsError> {
        for mutant in self.mutants {
            let began = Instant::now();
            let verdict = match self.broken.iter().find(|it| it.0 == &mutant.check) {
                Some((_, said)) => Verdict::NoUse(said.clone()),
                None => self.try_mutant(mutant)?,
            };
            each(&Outcome {
                mutant: mutant.name.clone(),
                check: mutant.check.to_string(),
                verdict,
                took: began.elapsed(),
            });
        }
        Ok(())
    }

    /// The checks that fail without a mutant, and their messages.
    fn broken(&self) -> Result<Vec<(&'a Check, String)>, MutantsError> {
        let mut checks: Vec<&Check> = Vec::new();
        for mutant in self.mutants {
            if !checks.contains(&&mutant.check) {
                checks.push(&mutant.check);
            }
        }
        let programs = self.programs(&checks)?;
        let mut broken = Vec::new();
        for check in checks {
            let program: &PathBuf = &programs[&check.target(&self.cargo.root)?];
            match self.cargo.run(check, program)? {
                Ran::Held => {}
                Ran::Failed(said) | Ran::Missed(said) => broken.push((check, said)),
                Ran::Hung => broken.push((check, "it hung".to_owned())),
            }
        }
        Ok(broken)
    }

    /// Builds the programs of all checks, with one build for each package.
    fn programs(&self, checks: &[&Check]) -> Result<Programs, MutantsError> {
        let mut groups: BTreeMap<(String, bool), Vec<Target>> = BTreeMap::new();
        for check in checks {
            let target = check.target(&self.cargo.root)?;
            let is_program = matches!(target.unit, Unit::Program(_));
            let group = groups.entry((target.package.clone(), is_program));
            let group = group.or_default();
            if !group.contains(&target) {
                group.push(target);
            }
        }
        let mut programs = Programs::new();
        for targets in groups.values() {
            let built = self.cargo.build(targets)?;
            programs.extend(built.map_err(MutantsError::Broken)?);
        }
        Ok(programs)
    }

    fn try_mutant(&self, mutant: &Mutant) -> Result<Verdict, MutantsError> {
        let shipped = self.tree.read(&mutant.file)?;
        let faulty = mutant.apply(&shipped).map_err(MutantsError::Gap)?;
        self.tree.write(&mutant.file, &faulty)?;
        let verdict = self.verdict(&mutant.check);
        self.tree.write(&mutant.file, &shipped)?;
        verdict
    }

    fn verdict(&self, check: &Check) -> Result<Verdict, MutantsError> {
        let target = check.target(&self.cargo.root)?;
        let programs = match self.cargo.build(std::slice::from_ref(&target))? {
            Ok(programs) => programs,
            Err(error) => return Ok(Verdict::NotCompiled(error)),
        };
        Ok(match self.cargo.run(check, &programs[&target])? {
            Ran::Failed(said) => Verdict::Killed(Killed::Said(said)),
            Ran::Hung => Verdict::Killed(Killed::Hung),
            Ran::Held => Verdict::Survived(None),
            Ran::Missed(said) => Verdict::Survived(Some(said)),
        })
    }
}
