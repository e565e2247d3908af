//! The results of a run, and their file.

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

/// The results of one run of a workload.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// The name of the workload.
    pub workload: String,
    /// The part of each message that subscribers read.
    pub read: Read,
    /// The command line of the run.
    pub command: String,
    /// The time when the run began, in seconds since 1970.
    pub began: u64,
    /// The number of repeats.
    pub repeats: u32,
    /// The machine of the run.
    pub machine: Machine,
    /// The figures, in the order of cases and peers.
    pub figures: Vec<PeerFigure>,
    /// The cases that failed.
    pub failures: Vec<PeerFailure>,
    /// The peers that did not run.
    pub skipped: Vec<Skipped>,
}

/// One figure of one peer: a line of the JSON output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerFigure {
    /// The name of the peer.
    pub peer: String,
    /// The name of the workload.
    pub workload: String,
    /// The case and the name of the figure, as `case/name`.
    pub figure: String,
    /// The unit of the values.
    pub unit: String,
    /// The median and the range of all repeats.
    #[serde(flatten)]
    pub summary: Summary,
    /// The median divided by that of SM2; `null` if SM2 has no figure, or one of 0.
    pub ratio_to_sm2: Option<f64>,
    /// The part of each message that subscribers read.
    pub read: Read,
    /// The values of all repeats.
    pub runs: Vec<f64>,
}

/// A case that failed on a peer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeerFailure {
    /// The name of the peer.
    pub peer: String,
    /// The name of the workload.
    pub workload: String,
    /// The label of the case.
    pub case: String,
    /// The number of the repeat, from 1.
    pub repeat: u32,
    /// The error.
    pub failed: String,
}

/// A peer that cannot run the workload here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skipped {
    /// The name of the peer.
    pub peer: String,
    /// The reason why it cannot.
    pub reason: String,
}

impl Results {
    /// Adds the value of one repeat of a figure.
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

    /// Computes the medians and ratios of all figures.
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

    /// The peers that have figures or failures, in the order of the catalogue.
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

    /// The cases, in their order: the parts before `/` of the names of figures.
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

    /// The name of the file for these results.
    #[must_use]
    pub fn file_name(&self) -> String {
        format!("{}-{}.json", self.workload, self.read.as_str())
    }

    /// Writes the results into this folder, and returns the path of the file.
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

    /// Reads all results in this folder, sorted by name.
    ///
    /// # Errors
    ///
    /// The folder or a file in it cannot be read, or a file is invalid.
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

/// Splits the name of a figure into the case and the rest.
#[must_use]
pub fn split(figure: &str) -> (&str, &str) {
    figure.split_once('/').unwrap_or(("", figure))
}

/// Joins a case and the rest of a figure's name.
#[must_use]
pub fn join(case: &str, figure: &str) -> String {
    match case {
        "" => figure.to_owned(),
        case => format!("{case}/{figure}"),
    }
}

#[cfg(test)]
pub(crate) mod tests;
