//! How the tables of `sm2 top` look.

use ratatui::{
    Frame,
    layout::{Alignment, Constraint, Layout},
    style::{Modifier, Style},
    text::Line,
    widgets::{Cell as Widget, Paragraph, Row, Table as Tables, TableState},
};

use super::{
    figures::{Cell, Figures, Tab, Table},
    state::State,
};

/// Between two columns.
const GAP: u16 = 2;

/// Draws all of it.
pub(super) fn draw(frame: &mut Frame<'_>, figures: &Figures, state: &mut State) {
    let areas = Layout::vertical([
        Constraint::Length(1),
        Constraint::Min(1),
        Constraint::Length(1),
    ]);
    let [head, body, foot] = areas.areas(frame.area());
    frame.render_widget(Paragraph::new(heading(figures, state)), head);
    let rows = state.rows(figures);
    state.selected = state.selected.min(rows.len().saturating_sub(1));
    let mut selection = TableState::new().with_selected(Some(state.selected));
    let table = table(figures.table(state.tab), &rows, Some(state));
    frame.render_stateful_widget(table, body, &mut selection);
    frame.render_widget(Paragraph::new(footer(state)), foot);
}

fn heading(figures: &Figures, state: &State) -> String {
    let tab = |tab: Tab, name: &str| {
        let count = figures.table(tab).rows.len();
        match tab == state.tab {
            true => format!("[{count} {name}]"),
            false => format!(" {count} {name} "),
        }
    };
    let manager = match state.connected {
        true => "",
        false => "  the Manager is gone: waiting for its successor",
    };
    format!(
        "sm2 top  {} {}{manager}",
        tab(Tab::Topics, "topics"),
        tab(Tab::Nodes, "nodes")
    )
}

fn footer(state: &State) -> String {
    match (state.typing, state.filter.is_empty()) {
        (true, _) => format!("/{}_  (Enter keeps it, Esc drops it)", state.filter),
        (false, false) => format!("names with {:?}  (Esc shows all)", state.filter),
        (false, true) => "q quit  Tab topics/nodes  s sort  r reverse  / filter".into(),
    }
}

fn table<'a>(table: &Table, rows: &[&Vec<Cell>], state: Option<&State>) -> Tables<'a> {
    let is_number = |column: usize| {
        let mut cells = table.rows.iter().filter_map(|row| row.get(column));
        cells.any(|cell| matches!(cell, Cell::Number(_)))
    };
    let aligned = |column: usize, text: String| {
        let alignment = match is_number(column) {
            true => Alignment::Right,
            false => Alignment::Left,
        };
        Widget::from(Line::from(text).alignment(alignment))
    };
    let headings = table.columns.iter().enumerate().map(|(at, column)| {
        let sign = match state.filter(|state| state.sort == at) {
            Some(state) if state.reverse => "^",
            Some(_) => "v",
            None => "",
        };
        aligned(at, format!("{}{sign}", column.heading))
    });
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let headings = Row::new(headings.collect::<Vec<_>>()).style(bold);
    let body = rows.iter().map(|row| {
        let cells = table.columns.iter().zip(row.iter()).enumerate();
        let cells = cells.map(|(at, (column, cell))| aligned(at, column.show(cell)));
        Row::new(cells.collect::<Vec<_>>())
    });
    let reversed = Style::new().add_modifier(Modifier::REVERSED);
    Tables::new(
        body.collect::<Vec<_>>(),
        widths(table).map(Constraint::Length),
    )
    .header(headings)
    .column_spacing(GAP)
    .row_highlight_style(reversed)
}

/// As wide as the longest cell, and the mark of sorting.
fn widths(table: &Table) -> impl Iterator<Item = u16> {
    let width = |at: usize| {
        let column = table.columns[at];
        let cells = table.rows.iter().filter_map(|row| row.get(at));
        let cells = cells.map(|cell| column.show(cell).chars().count());
        let widest = cells.max().unwrap_or(0).max(column.heading.len() + 1);
        u16::try_from(widest).unwrap_or(u16::MAX)
    };
    let widths: Vec<_> = (0..table.columns.len()).map(width).collect();
    widths.into_iter()
}

/// A table as lines of text, all of it.
pub(super) fn text(figures: &Figures, tab: Tab) -> Vec<String> {
    let table = figures.table(tab);
    let widths: Vec<_> = widths(table).map(usize::from).collect();
    let is_text = |at: usize| {
        let mut cells = table.rows.iter().filter_map(|row| row.get(at));
        cells.any(|cell| matches!(cell, Cell::Text(_)))
    };
    let line = |cells: Vec<String>| {
        let cells = cells
            .iter()
            .enumerate()
            .map(|(at, cell)| match is_text(at) {
                true => format!("{cell:<0$}", widths[at]),
                false => format!("{cell:>0$}", widths[at]),
            });
        let line = cells.collect::<Vec<_>>().join("  ");
        line.trim_end().to_owned()
    };
    let headings = table.columns.iter().map(|column| column.heading.to_owned());
    let mut lines = vec![line(headings.collect())];
    for row in &table.rows {
        let cells = table.columns.iter().zip(row);
        lines.push(line(
            cells.map(|(column, cell)| column.show(cell)).collect(),
        ));
    }
    lines
}

#[cfg(test)]
mod tests;
