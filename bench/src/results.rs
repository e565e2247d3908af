//! What a run found out, as it is kept in a file.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use crate::{
    job::Read,
    machine::Machine,
    peers::PEERS,
    stats::{Summary, summary},
};

/// All of one workload's run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// Which workload.
    pub workload: String,
    /// What subscribers did with messages.
    pub read: Read,
    /// The command that made this.
    pub command: String,
    /// When it began, in seconds since 1970.
    pub began: u64,
    /// How often all was run.
    pub repeats: u32,
    /// On what.
    pub machine: Machine,
    /// In the order of cases and peers.
    pub figures: Vec<PeerFigure>,
    /// What went wrong.
    pub failures: Vec<PeerFailure>,
    /// Who did not run.
    pub skipped: Vec<Skipped>,
}

/// One figure of one peer: a line of the JSON output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerFigure {
    /// Whose.
    pub peer: String,
    /// Of which workload.
    pub workload: String,
    /// What: the case and the figure.
    pub figure: String,
    /// In what.
    pub unit: String,
    /// Of the repeats.
    #[serde(flatten)]
    pub summary: Summary,
    /// Its median divided by SM2's; `null` if there is none, or it is 0.
    pub ratio_to_sm2: Option<f64>,
    /// What subscribers did with messages.
    pub read: Read,
    /// Each repeat's.
    pub runs: Vec<f64>,
}

/// A case that a peer did not get through.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerFailure {
    /// Who.
    pub peer: String,
    /// In which workload.
    pub workload: String,
    /// In which case.
    pub case: String,
    /// In which repeat, from 1.
    pub repeat: u32,
    /// What happened.
    pub failed: String,
}

/// A peer that cannot run the workload here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skipped {
    /// Who.
    pub peer: String,
    /// Why.
    pub reason: String,
}

impl Results {
    /// One more run of a figure.
    pub fn record(&mut self, peer: &str, figure: &str, unit: &str, value: f64) {
        let known = |known: &&mut PeerFigure| known.peer == peer && known.figure == figure;
        match self.figures.iter_mut().find(known) {
            Some(known) => known.runs.push(value),
            None => self.figures.push(PeerFigure {
                peer: peer.to_owned(),
                workload: self.workload.clone(),
                figure: figure.to_owned(),
                unit: unit.to_owned(),
                summary: Summary {
                    median: value,
                    min: value,
                    max: value,
                },
                ratio_to_sm2: None,
                read: self.read,
                runs: vec![value],
            }),
        }
    }

    /// Makes medians and ratios of all runs.
    pub fn conclude(&mut self) {
        for figure in &mut self.figures {
            if let Some(summary) = summary(&figure.runs) {
                figure.summary = summary;
            }
        }
        let reference = PEERS[0].name;
        let own: Vec<_> = self
            .figures
            .iter()
            .filter(|figure| figure.peer == reference && figure.summary.median != 0.0)
            .map(|figure| (figure.figure.clone(), figure.summary.median))
            .collect();
        for figure in &mut self.figures {
            let own = own.iter().find(|(name, _)| *name == figure.figure);
            figure.ratio_to_sm2 = own.map(|(_, median)| figure.summary.median / median);
        }
    }

    /// The figure of a peer.
    #[must_use]
    pub fn find(&self, peer: &str, figure: &str) -> Option<&PeerFigure> {
        let mut all = self.figures.iter();
        all.find(|known| known.peer == peer && known.figure == figure)
    }

    /// Those who have figures or failures, in the order of the catalogue.
    #[must_use]
    pub fn peers(&self) -> Vec<&'static str> {
        let names = PEERS.iter().map(|peer| peer.name);
        names
            .filter(|name| {
                self.figures.iter().any(|figure| figure.peer == *name)
                    || self.failures.iter().any(|failure| failure.peer == *name)
            })
            .collect()
    }

    /// The cases, in their order: what stands before `/` in the names of figures.
    #[must_use]
    pub fn cases(&self) -> Vec<String> {
        let mut cases = Vec::new();
        for figure in &self.figures {
            let case = split(&figure.figure).0.to_owned();
            if !cases.contains(&case) {
                cases.push(case);
            }
        }
        cases
    }

    /// Its file's name.
    #[must_use]
    pub fn file_name(&self) -> String {
        format!("{}-{}.json", self.workload, self.read.as_str())
    }

    /// Keeps it in this folder.
    ///
    /// # Errors
    ///
    /// The folder cannot be written to.
    pub fn save(&self, dir: &Path) -> io::Result<PathBuf> {
        fs::create_dir_all(dir)?;
        let path = dir.join(self.file_name());
        let mut text = serde_json::to_string_pretty(self)?;
        text.push('\n');
        fs::write(&path, text)?;
        Ok(path)
    }

    /// All that are kept in this folder, by name.
    ///
    /// # Errors
    ///
    /// The folder, or a file in it, cannot be read or understood.
    pub fn load_all(dir: &Path) -> io::Result<Vec<Self>> {
        let mut paths = Vec::new();
        for entry in fs::read_dir(dir)? {
            let path = entry?.path();
            if path.extension().is_some_and(|ending| ending == "json") {
                paths.push(path);
            }
        }
        paths.sort();
        let load = |path: PathBuf| Ok(serde_json::from_str(&fs::read_to_string(path)?)?);
        paths.into_iter().map(load).collect()
    }
}

/// A figure's case and its own name.
#[must_use]
pub fn split(figure: &str) -> (&str, &str) {
    figure.split_once('/').unwrap_or(("", figure))
}

/// A case and a figure's own name together.
#[must_use]
pub fn join(case: &str, figure: &str) -> String {
    match case {
        "" => figure.to_owned(),
        case => format!("{case}/{figure}"),
    }
}

#[cfg(test)]
pub(crate) mod tests;
