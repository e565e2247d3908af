//! Every MUST of SPEC.md is implemented by code that cites it and watched by
//! a check that cites it.
//!
//! [`check`] reads SPEC.md and every source file below a workspace and
//! returns a [`Report`]: the citations of each clause, and each [`Gap`]. The
//! check verifies that a citation is well-formed and names a clause in force;
//! it does not verify that the claim of a citation is true.
//!
//! A clause of SPEC.md is one line: its id in bold, its level in brackets,
//! its text. A withdrawn id stays as a struck-out id with the level
//! `RETIRED`. Code cites by a comment line of its own, `=` right after the
//! comment marker, then ids separated by commas, then for a check its kind
//! ([`CheckKind`]). Golden vectors cite by their field `clause`. An id that is a literal argument of
//! the macros `clause!` and `violation!` must name a clause in force, and is not a citation.
//!
//! Annex B has the procedures. Each frame, code and fate of the tables must be in them.

mod annex;
mod citation;
mod gap;
mod id;
mod role;
mod spec;
mod walk;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use self::citation::Citation;
pub use self::gap::{CheckError, Gap, GapKind, SourceLine};
pub use self::id::ClauseId;
pub use self::role::{CheckKind, Role};
pub use self::spec::Level;
use self::spec::Spec;

/// Name of the normative text, directly below the workspace root.
const SPEC_FILE: &str = "SPEC.md";

/// Reads SPEC.md and all sources below `root` and compares them.
///
/// # Errors
/// SPEC.md is missing, or a file or folder cannot be read. Gaps are not errors:
/// they are in the report.
pub fn check(root: &Path) -> Result<Report, CheckError> {
    let spec_path = root.join(SPEC_FILE);
    if !spec_path.is_file() {
        return Err(CheckError::NoSpec(spec_path));
    }
    let (text, file) = (read(&spec_path)?, Path::new(SPEC_FILE));
    let (spec, mut gaps) = spec::parse(&text, file);
    gaps.extend(annex::unmentioned(&text, file));
    let mut report = Report::of(spec);
    for source in walk::sources(root)? {
        let shown = source.path.strip_prefix(root).unwrap_or(&source.path);
        let text = read(&source.path)?;
        let (mut citations, unreadable) = citation::scan(&text, source.syntax, shown);
        gaps.extend(unreadable);
        if source.names_clauses() {
            citations.extend(citation::scan_macros(&text, shown));
        }
        gaps.extend(citations.into_iter().filter_map(|it| report.add(it)));
    }
    gaps.extend(report.uncited());
    gaps.sort_by(|a, b| a.at.cmp(&b.at));
    report.gaps = gaps;
    Ok(report)
}

fn read(path: &Path) -> Result<String, CheckError> {
    let bytes = fs::read(path).map_err(|source| CheckError::Read {
        path: path.to_owned(),
        source,
    })?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// The result of [`check`].
#[derive(Debug)]
pub struct Report {
    clauses: BTreeMap<ClauseId, Traced>,
    gaps: Vec<Gap>,
}

impl Report {
    fn of(spec: Spec) -> Self {
        let trace = |(id, clause): (ClauseId, spec::Clause)| {
            let traced = Traced {
                level: clause.level,
                at: clause.at,
                code: Vec::new(),
                checks: Vec::new(),
            };
            (id, traced)
        };
        Self {
            clauses: spec.clauses.into_iter().map(trace).collect(),
            gaps: Vec::new(),
        }
    }

    /// Adds the citation to its clause, or returns the gap.
    fn add(&mut self, citation: Citation) -> Option<Gap> {
        let Citation { id, role, at } = citation;
        let Some(traced) = self.clauses.get_mut(&id) else {
            return Some(Gap::new(at, GapKind::UnknownId { id }));
        };
        match (traced.level, role) {
            (Level::Draft, _) => return Some(Gap::new(at, GapKind::CitesDraft { id })),
            (Level::Retired, _) => return Some(Gap::new(at, GapKind::CitesRetired { id })),
            (Level::Must | Level::Should | Level::May, Role::Code) => traced.code.push(at),
            (Level::Must | Level::Should | Level::May, Role::Check(kind)) => {
                traced.checks.push((kind, at));
            }
            (Level::Must | Level::Should | Level::May, Role::Name) => {}
        }
        None
    }

    /// The MUST clauses that no code or no check cites.
    fn uncited(&self) -> Vec<Gap> {
        let mut gaps = Vec::new();
        for (&id, traced) in &self.clauses {
            if traced.level != Level::Must {
                continue;
            }
            if traced.code.is_empty() {
                gaps.push(Gap::new(traced.at.clone(), GapKind::NoCode { id }));
            }
            if traced.checks.is_empty() {
                gaps.push(Gap::new(traced.at.clone(), GapKind::NoCheck { id }));
            }
        }
        gaps
    }

    /// Every clause of SPEC.md with its citations, by id.
    #[must_use]
    pub const fn clauses(&self) -> &BTreeMap<ClauseId, Traced> {
        &self.clauses
    }

    /// All gaps, sorted by line. The check passes if there are none.
    #[must_use]
    pub fn gaps(&self) -> &[Gap] {
        &self.gaps
    }

    /// The counts in one line.
    #[must_use]
    pub fn summary(&self) -> String {
        let levels: Vec<String> = Level::ALL
            .iter()
            .map(|&level| {
                let count = self.clauses.values().filter(|it| it.level == level).count();
                format!("{count} {level}")
            })
            .collect();
        let code: usize = self.clauses.values().map(|it| it.code.len()).sum();
        let checks: usize = self.clauses.values().map(|it| it.checks.len()).sum();
        format!(
            "clauses: {}; {code} code links, {checks} check links; {} gaps",
            levels.join(", "),
            self.gaps.len()
        )
    }
}

/// One clause and its citations.
#[derive(Debug)]
pub struct Traced {
    /// The level of the clause.
    pub level: Level,
    /// Its line in SPEC.md.
    pub at: SourceLine,
    /// The code that cites the clause.
    pub code: Vec<SourceLine>,
    /// The checks that cite the clause.
    pub checks: Vec<(CheckKind, SourceLine)>,
}
