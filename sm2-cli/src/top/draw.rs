//! The layout of the `sm2 top` screen.

use ratatui::{
    Frame,
    layout::{Alignment, Constraint, Layout},
    style::{Color, Modifier, Style},
    text::Line,
    widgets::{Cell as Widget, Paragraph, Row, Table as Tables, TableState},
};
use sm2_proto::text::Counted;

use super::{
    figures::{Figures, Tab},
    history::History,
    state::State,
    table::{Cell, Table},
};

/// The blanks between two columns.
const GAP: u16 = 2;

/// The smallest width of the sparklines: with less room there are none.
const TREND: u16 = 8;

/// Draws the whole screen.
pub(super) fn draw(frame: &mut Frame<'_>, figures: &Figures, history: &History, state: &mut State) {
    let areas = Layout::vertical([
        Constraint::Length(1),
        Constraint::Min(1),
        Constraint::Length(1),
    ]);
    let [head, body, foot] = areas.areas(frame.area());
    let screen = frame.area().width;
    let alarm = match state.connected {
        true => Style::new(),
        false => alarm(state),
    };
    frame.render_widget(
        Paragraph::new(heading(figures, state, screen)).style(alarm),
        head,
    );
    let rows = state.rows(figures);
    state.selected = state.selected.min(rows.len().saturating_sub(1));
    let mut selection = TableState::new().with_selected(Some(state.selected));
    let shown = figures.table(state.tab);
    let widths = widths(shown);
    let columns = fitting_columns(shown, &widths, state.sort, screen);
    let hidden = shown.shown_columns(state.sort).len() - columns.len();
    let taken = needed(&widths, &columns) + usize::from(GAP);
    let room = usize::from(screen).checked_sub(taken);
    let room = room.filter(|it| *it >= usize::from(TREND));
    let trends = room.map(|room| trends(&rows, history, state.tab, room));
    let table = table(shown, &widths, &rows, &columns, trends, state, screen);
    frame.render_stateful_widget(table, body, &mut selection);
    frame.render_widget(Paragraph::new(footer(state, hidden, screen)), foot);
}

/// The tabs, and whether there is a Manager.
fn heading(figures: &Figures, state: &State, screen: u16) -> String {
    let tab = |tab: Tab, noun: &str| {
        let count = Counted::new(figures.table(tab).rows.len() as u64, noun);
        match tab == state.tab {
            true => format!("[{count}]"),
            false => format!(" {count} "),
        }
    };
    let (topics, nodes) = (tab(Tab::Topics, "topic"), tab(Tab::Nodes, "node"));
    let tabs = format!("sm2 top  {topics} {nodes}");
    match state.connected {
        true => tabs,
        false => {
            let lost = "  the Manager is gone: waiting for its successor";
            let line = format!("{tabs}{lost}");
            match line.len() <= usize::from(screen) {
                true => line,
                false => format!("no Manager  {topics} {nodes}"),
            }
        }
    }
}

/// The keys, as many as fit; first the number of columns that do not fit.
fn footer(state: &State, hidden: usize, screen: u16) -> String {
    match (state.filter.is_typed, state.filter.text.is_empty()) {
        (true, _) => return format!("/{}_  (Enter keeps it, Esc drops it)", state.filter.text),
        (false, false) => return format!("names with {:?}  (Esc shows all)", state.filter.text),
        (false, true) => {}
    }
    let hidden = (hidden > 0).then(|| {
        let columns = Counted::new(hidden as u64, "column");
        format!("{columns} hidden")
    });
    let keys = [
        "q quit",
        "Tab topics/nodes",
        "s sort",
        "r reverse",
        "/ filter",
    ];
    let mut line = String::new();
    for part in hidden
        .into_iter()
        .chain(keys.into_iter().map(str::to_owned))
    {
        let gap = if line.is_empty() { "" } else { "  " };
        if line.len() + gap.len() + part.len() > usize::from(screen) {
            break;
        }
        line += gap;
        line += &part;
    }
    line
}

/// The columns that fit the screen, in their order. A cell is never cut: whole columns are left out, by
/// their rank. The name stays, and the column that sorts the rows is left out last.
fn fitting_columns(table: &Table, widths: &[usize], sort: usize, screen: u16) -> Vec<usize> {
    let mut columns = table.shown_columns(sort);
    while needed(widths, &columns) > usize::from(screen) {
        let others = columns.iter().enumerate().skip(1);
        let lowest = others.min_by_key(|&(_, &at)| (at == sort, table.columns[at].rank));
        let Some((index, _)) = lowest else {
            break;
        };
        columns.remove(index);
    }
    columns
}

/// The width of these columns.
fn needed(widths: &[usize], columns: &[usize]) -> usize {
    let cells: usize = columns.iter().map(|at| widths[*at]).sum();
    cells + columns.len().saturating_sub(1) * usize::from(GAP)
}

/// The sparklines of all rows, each at most as wide as `width`.
fn trends(rows: &[&Vec<Cell>], history: &History, tab: Tab, width: usize) -> Vec<String> {
    let sparkline = |row: &&Vec<Cell>| {
        let name = row.first().map_or("", Cell::as_text);
        history.sparkline(tab, name, width)
    };
    rows.iter().map(sparkline).collect()
}

/// The style of what asks for attention.
fn alarm(state: &State) -> Style {
    match state.colours {
        true => Style::new().fg(Color::Red),
        false => Style::new(),
    }
}

fn table<'a>(
    table: &Table,
    widths: &[usize],
    rows: &[&Vec<Cell>],
    columns: &[usize],
    trends: Option<Vec<String>>,
    state: &State,
    screen: u16,
) -> Tables<'a> {
    let is_number = |column: usize| {
        let mut cells = table.rows.iter().filter_map(|row| row.get(column));
        cells.any(|cell| matches!(cell, Cell::Number(_) | Cell::Old(_)))
    };
    let aligned = |column: usize, text: String| {
        let alignment = match is_number(column) {
            true => Alignment::Right,
            false => Alignment::Left,
        };
        let text = shortened(text, screen.into());
        Widget::from(Line::from(text).alignment(alignment))
    };
    let headings = columns.iter().map(|&at| {
        let sign = match (state.sort == at, state.reverse) {
            (true, true) => "^",
            (true, false) => "v",
            (false, _) => "",
        };
        aligned(at, format!("{}{sign}", table.columns[at].heading))
    });
    let trend = trends.is_some().then(|| Widget::from("TREND"));
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let headings = Row::new(headings.chain(trend).collect::<Vec<_>>()).style(bold);
    let cell = |at: usize, cell: &Cell| {
        let column = table.columns[at];
        let shown = aligned(at, column.show(cell));
        match cell {
            Cell::Number(Some(number)) if column.is_loss && *number > 0.0 => {
                shown.style(alarm(state))
            }
            Cell::Old(_) => shown.style(Style::new().add_modifier(Modifier::DIM)),
            Cell::Number(_) | Cell::Text(_) | Cell::Type(_) => shown,
        }
    };
    let coloured = match state.colours {
        true => Style::new().fg(Color::Cyan),
        false => Style::new(),
    };
    let has_trends = trends.is_some();
    let mut trends = trends.into_iter().flatten();
    let body: Vec<_> = rows
        .iter()
        .map(|row| {
            let cells = columns.iter().map(|&at| cell(at, &row[at]));
            let trend = trends.next().map(|it| Widget::from(it).style(coloured));
            Row::new(cells.chain(trend).collect::<Vec<_>>())
        })
        .collect();
    let reversed = Style::new().add_modifier(Modifier::REVERSED);
    let constraints = columns.iter().map(|&at| {
        let width = u16::try_from(widths[at]).unwrap_or(u16::MAX);
        Constraint::Length(width.min(screen))
    });
    Tables::new(
        body,
        constraints.chain(has_trends.then_some(Constraint::Min(TREND))),
    )
    .header(headings)
    .column_spacing(GAP)
    .row_highlight_style(reversed)
}

/// A text that is wider than the screen ends in `…`.
fn shortened(text: String, screen: usize) -> String {
    match text.char_indices().nth(screen) {
        None => text,
        Some(_) => {
            let start: String = text.chars().take(screen.saturating_sub(1)).collect();
            format!("{start}…")
        }
    }
}

/// The widths of all columns: that of the longest cell, or of the heading with the sign of sorting.
fn widths(table: &Table) -> Vec<usize> {
    let width = |at: usize| {
        let column = table.columns[at];
        let cells = table.rows.iter().filter_map(|row| row.get(at));
        let cells = cells.map(|cell| column.show(cell).chars().count());
        cells.max().unwrap_or(0).max(column.heading.len() + 1)
    };
    (0..table.columns.len()).map(width).collect()
}

/// The lines of a whole table, with all columns.
pub(super) fn text(figures: &Figures, tab: Tab) -> Vec<String> {
    let table = figures.table(tab);
    let widths = widths(table);
    let is_text = |at: usize| {
        let mut cells = table.rows.iter().filter_map(|row| row.get(at));
        cells.any(|cell| matches!(cell, Cell::Text(_) | Cell::Type(_)))
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
