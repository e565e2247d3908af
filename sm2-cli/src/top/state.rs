//! The state of the `sm2 top` screen: the table that is shown, its order, and its filter.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::{
    figures::{Figures, Tab},
    table::Cell,
};

/// The consequence of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum After {
    GoOn,
    Quit,
}

/// The names of the rows that are shown.
#[derive(Clone, Debug, Default)]
pub(super) struct Filter {
    /// Only rows whose name contains this text are shown.
    pub(super) text: String,
    /// Whether keys are appended to the text.
    pub(super) is_typed: bool,
}

/// The selection of figures that is shown, and their order.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub(super) tab: Tab,
    /// The column that sorts the rows. Column 0 is the name.
    pub(super) sort: usize,
    pub(super) reverse: bool,
    pub(super) filter: Filter,
    /// The index of the selected row among the rows that are shown.
    pub(super) selected: usize,
    /// Whether a Manager is connected.
    pub(super) connected: bool,
    /// Whether the terminal shows colours.
    pub(super) colours: bool,
}

impl Default for State {
    fn default() -> Self {
        Self {
            tab: Tab::default(),
            sort: 0,
            reverse: false,
            filter: Filter::default(),
            selected: 0,
            connected: true,
            colours: false,
        }
    }
}

impl State {
    /// Handles a key.
    pub(super) fn key(&mut self, key: KeyEvent, figures: &Figures) -> After {
        if key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL) {
            return After::Quit;
        }
        if self.filter.is_typed {
            self.type_into_filter(key.code);
            return After::GoOn;
        }
        let last = self.rows(figures).len().saturating_sub(1);
        match key.code {
            KeyCode::Char('q') => return After::Quit,
            KeyCode::Tab | KeyCode::BackTab | KeyCode::Left | KeyCode::Right => self.switch(),
            KeyCode::Up | KeyCode::Char('k') => self.selected = self.selected.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => self.selected += 1,
            KeyCode::PageUp => self.selected = self.selected.saturating_sub(10),
            KeyCode::PageDown => self.selected += 10,
            KeyCode::Home => self.selected = 0,
            KeyCode::End => self.selected = last,
            KeyCode::Char('s') => {
                self.sort = (self.sort + 1) % figures.table(self.tab).columns.len().max(1)
            }
            KeyCode::Char('r') => self.reverse = !self.reverse,
            KeyCode::Char('/') => self.filter.is_typed = true,
            KeyCode::Esc => self.filter.text.clear(),
            _ => {}
        }
        self.selected = self.selected.min(last);
        After::GoOn
    }

    fn type_into_filter(&mut self, code: KeyCode) {
        match code {
            KeyCode::Enter => self.filter.is_typed = false,
            KeyCode::Esc => {
                self.filter.is_typed = false;
                self.filter.text.clear();
            }
            KeyCode::Backspace => drop(self.filter.text.pop()),
            KeyCode::Char(c) => self.filter.text.push(c),
            _ => {}
        }
        self.selected = 0;
    }

    fn switch(&mut self) {
        self.tab = match self.tab {
            Tab::Topics => Tab::Nodes,
            Tab::Nodes => Tab::Topics,
        };
        (self.sort, self.reverse, self.selected) = (0, false, 0);
    }

    /// The rows that are shown, in the order in which they are shown.
    pub(super) fn rows<'a>(&self, figures: &'a Figures) -> Vec<&'a Vec<Cell>> {
        let wanted = self.filter.text.to_lowercase();
        let named = |row: &&Vec<Cell>| match row.first() {
            Some(name) => name.as_text().to_lowercase().contains(&wanted),
            None => false,
        };
        let mut rows: Vec<_> = figures.table(self.tab).rows.iter().filter(named).collect();
        // The sort is stable: equal rows stay in the order of their names.
        rows.sort_by(
            |one, other| match (one.get(self.sort), other.get(self.sort)) {
                (Some(one), Some(other)) => one.order(other),
                _ => std::cmp::Ordering::Equal,
            },
        );
        if self.reverse {
            rows.reverse();
        }
        rows
    }
}

#[cfg(test)]
pub(super) mod tests;
