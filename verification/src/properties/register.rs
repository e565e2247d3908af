//! The tables of PROPERTIES.md, and the checks that other files list.

use std::collections::{BTreeMap, BTreeSet};

use super::check::{Check, Run};
use super::listed::Listed;
use super::table::{Document, Row, Rows};
use super::{Engine, Gap, GapKind};
use crate::clauses::ClauseId;

const GROUPS: [&str; 3] = ["group", "claim", "bound"];
const ENGINES: [&str; 2] = ["engine", "strength of the result"];
const PROPERTIES: [&str; 3] = ["property", "statement", "clauses"];
const SETS: [&str; 2] = ["set", "properties"];
const CHECKS: [&str; 5] = ["harness", "shows", "engine", "bound", "run"];

/// A row of the table of groups: properties with common prefixes.
#[derive(Clone, Debug)]
pub struct Group {
    /// The prefixes, such as `MGR`, separated by commas.
    pub prefixes: String,
    /// The claim of the group.
    pub shown: String,
    /// The bound of the claim.
    pub bound: String,
}

/// A row of the table of properties.
#[derive(Clone, Debug)]
pub struct Property {
    /// The name, such as `MGR-STRICT`.
    pub name: String,
    /// The clauses that require it.
    pub clauses: Vec<ClauseId>,
    /// Its line in PROPERTIES.md, counted from 1.
    pub line: usize,
}

impl Group {
    /// True if a property belongs to this group.
    #[must_use]
    pub fn has(&self, property: &str) -> bool {
        let (prefix, _) = property.split_once('-').unwrap_or((property, ""));
        words(&self.prefixes).any(|it| it == prefix)
    }
}

/// The parsed PROPERTIES.md, with the checks that other files list.
#[derive(Clone, Debug)]
pub struct Register {
    groups: Vec<Group>,
    engines: Vec<(String, String)>,
    properties: Vec<Property>,
    checks: Vec<Check>,
}

impl Register {
    /// Parses the tables, and adds the checks of `listed`; returns the gaps for the rows that cannot be parsed.
    #[must_use]
    pub fn parse(text: &str, listed: &Listed) -> (Self, Vec<Gap>) {
        let document = Document::new(text);
        let mut gaps = Vec::new();
        let mut rows = |columns: &[&str]| {
            let Rows { rows, untidy } = document.rows(columns);
            let gap = |line| Gap::at(line + 1, GapKind::Untidy);
            gaps.extend(untidy.into_iter().map(gap));
            rows
        };
        let [groups, engines] = [rows(&GROUPS), rows(&ENGINES)];
        let [properties, sets, checks] = [rows(&PROPERTIES), rows(&SETS), rows(&CHECKS)];
        let set = |row: &Row| SETS.map(|it| row.cell(it).to_owned()).into();
        let sets: BTreeMap<String, String> = sets.iter().map(set).collect();
        let group = |row: Row| Group {
            prefixes: row.cell(GROUPS[0]).to_owned(),
            shown: row.cell(GROUPS[1]).to_owned(),
            bound: row.cell(GROUPS[2]).to_owned(),
        };
        let engine = |row: Row| ENGINES.map(|it| row.cell(it).to_owned()).into();
        let mut read = Self {
            groups: groups.into_iter().map(group).collect(),
            engines: engines.into_iter().map(engine).collect(),
            properties: Vec::new(),
            checks: Vec::new(),
        };
        for row in properties {
            let line = row.number();
            match property(row) {
                Ok(property) => read.properties.push(property),
                Err(kind) => gaps.push(Gap::at(line, kind)),
            }
        }
        for row in checks {
            let line = row.number();
            match check(row) {
                Ok(check) => read.checks.push(check),
                Err(kind) => gaps.push(Gap::at(line, kind)),
            }
        }
        read.checks.extend(listed.checks());
        for check in &mut read.checks {
            // The name of a set stands for the properties of the set.
            let shows = check.shows.iter();
            let shows = shows.flat_map(|word| words(sets.get(word).unwrap_or(word)));
            check.shows = shows.map(str::to_owned).collect();
        }
        gaps.extend(read.disagreements());
        (read, gaps)
    }

    /// The table of groups.
    #[must_use]
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// The table of engines: each, and strength of the result.
    #[must_use]
    pub fn engines(&self) -> &[(String, String)] {
        &self.engines
    }

    /// The table of properties.
    #[must_use]
    pub fn properties(&self) -> &[Property] {
        &self.properties
    }

    /// All tables of checks.
    #[must_use]
    pub fn checks(&self) -> &[Check] {
        &self.checks
    }

    /// The row of a check. Kani's are those of the stand-in, which runs the same harnesses.
    #[must_use]
    pub fn check(&self, engine: Engine, harness: &str) -> Option<&Check> {
        let is_it = |it: &&Check| it.harness == harness;
        self.of(engine).find(is_it)
    }

    /// The rows that an engine runs.
    pub fn of(&self, engine: Engine) -> impl Iterator<Item = &Check> {
        let engine = match engine {
            Engine::Kani => Engine::StandIn,
            other => other,
        };
        self.checks.iter().filter(move |it| it.engine == engine)
    }

    /// The engines whose checks show a property, each with their number.
    #[must_use]
    pub fn shown_by(&self, property: &str) -> String {
        let shows = |it: &&Check| it.shows.iter().any(|name| name == property);
        counted(self.checks.iter().filter(shows))
    }

    /// Rows that repeat or contradict each other.
    fn disagreements(&self) -> Vec<Gap> {
        let mut gaps = Vec::new();
        let mut names = BTreeSet::new();
        for property in &self.properties {
            let (name, line) = (property.name.clone(), property.line);
            if !self.groups.iter().any(|it| it.has(&name)) {
                gaps.push(Gap::at(line, GapKind::NoGroup(name.clone())));
            }
            // A mutant shows a property of a check, not of the shipped code.
            let shows = |it: &Check| it.engine != Engine::Mutants && it.shows.contains(&name);
            if !self.checks.iter().any(shows) {
                gaps.push(Gap::at(line, GapKind::Unshown(name.clone())));
            }
            if !names.insert(name.clone()) {
                gaps.push(Gap::at(line, GapKind::Twice(name)));
            }
        }
        let mut harnesses = BTreeSet::new();
        for check in &self.checks {
            if !self
                .engines
                .iter()
                .any(|(word, _)| word == check.engine.word())
            {
                gaps.push(check.gap(GapKind::NoEngine(check.engine)));
            }
            if check.shows.is_empty() {
                gaps.push(check.gap(GapKind::NoClaim(check.harness.clone())));
            }
            let unknown = check.shows.iter().filter(|name| !names.contains(*name));
            gaps.extend(unknown.map(|it| check.gap(GapKind::UnknownProperty(it.clone()))));
            if !harnesses.insert((check.engine, &check.harness)) {
                gaps.push(check.gap(GapKind::Twice(check.harness.clone())));
            }
        }
        gaps
    }
}

/// `model 3, angr 1`: the engines of these checks.
pub(super) fn counted<'a>(checks: impl Iterator<Item = &'a Check>) -> String {
    let mut counts = BTreeMap::new();
    for check in checks {
        *counts.entry(check.engine).or_insert(0_usize) += 1;
    }
    let words: Vec<_> = counts
        .iter()
        .map(|(engine, count)| format!("{engine} {count}"))
        .collect();
    words.join(", ")
}

fn property(row: Row) -> Result<Property, GapKind> {
    let clause = |word: &str| ClauseId::parse(word).ok_or_else(|| GapKind::Clause(word.to_owned()));
    Ok(Property {
        name: row.cell(PROPERTIES[0]).to_owned(),
        clauses: words(row.cell(PROPERTIES[2]))
            .map(clause)
            .collect::<Result<_, _>>()?,
        line: row.number(),
    })
}

/// The check of a row.
fn check(row: Row) -> Result<Check, GapKind> {
    let [harness, shows, engine, run] =
        [CHECKS[0], CHECKS[1], CHECKS[2], CHECKS[4]].map(|it| row.cell(it).to_owned());
    let (word, strength) = match engine.split_once(", ") {
        Some((word, strength)) => (word, Some(strength.to_owned())),
        None => (engine.as_str(), None),
    };
    let quoted = harness
        .strip_prefix('`')
        .and_then(|it| it.strip_suffix('`'));
    Ok(Check {
        harness: quoted.ok_or(GapKind::Harness(harness.clone()))?.to_owned(),
        shows: words(&shows).map(str::to_owned).collect(),
        engine: Engine::named(word).ok_or_else(|| GapKind::Engine(word.to_owned()))?,
        run: match run.as_str() {
            "quick" => Run::Quick,
            "full" => Run::Full,
            _ => return Err(GapKind::Run(run)),
        },
        strength,
        line: Some(row.number()),
    })
}

/// The words between commas.
fn words(cell: &str) -> impl Iterator<Item = &str> {
    cell.split(',')
        .map(str::trim)
        .filter(|word| !word.is_empty())
}
