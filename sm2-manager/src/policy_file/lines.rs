//! The places of the tables of a policy file.

use super::toml_file::File;

/// The line of each table, from 1.
#[derive(Clone, Debug, Default)]
pub(super) struct Lines {
    pub(super) rules: Vec<usize>,
    pub(super) bindings: Vec<usize>,
    pub(super) exclusive: Vec<usize>,
}

impl Lines {
    /// The lines of all tables, in the order of [`File::names`].
    pub(super) fn all(&self) -> impl Iterator<Item = usize> {
        let lines = self.rules.iter().chain(&self.bindings);
        lines.chain(&self.exclusive).copied()
    }

    /// The line of the last table.
    pub(super) fn last(&self) -> usize {
        self.all().max().unwrap_or(1)
    }

    /// The line of the second table of a name.
    pub(super) fn of_duplicate(&self, file: &File) -> Option<usize> {
        let mut tables: Vec<_> = self.all().zip(file.names()).collect();
        tables.sort_unstable();
        let second = tables.iter().enumerate().find(|(index, (_, name))| {
            let mut earlier = tables[..*index].iter();
            earlier.any(|(_, it)| it == name)
        });
        second.map(|(_, (line, _))| *line)
    }
}
