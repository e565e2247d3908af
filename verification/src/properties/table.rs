//! Tables of Markdown, line by line.

/// A text; some of its lines are rows of tables.
#[derive(Clone, Debug)]
pub(super) struct Document {
    lines: Vec<String>,
}

/// A row: where it is, and its cells by the names of their columns.
#[derive(Clone, Debug)]
pub(super) struct Row {
    /// Its line, counted from 0.
    pub(super) line: usize,
    cells: Vec<(String, String)>,
}

impl Row {
    /// Its line, counted from 1.
    pub(super) const fn number(&self) -> usize {
        self.line + 1
    }

    /// The cell of that column; empty where there is none.
    pub(super) fn cell(&self, column: &str) -> &str {
        let found = self.cells.iter().find(|(name, _)| name == column);
        found.map_or("", |(_, cell)| cell)
    }
}

/// The rows of the tables that have one header.
#[derive(Debug, Default)]
pub(super) struct Rows {
    /// The rows, from the top.
    pub(super) rows: Vec<Row>,
    /// Lines with another number of cells, or other spaces than one on each side of a cell.
    pub(super) untidy: Vec<usize>,
}

impl Document {
    /// Reads a text.
    pub(super) fn new(text: &str) -> Self {
        Self {
            lines: text.split('\n').map(str::to_owned).collect(),
        }
    }

    /// The rows of all tables whose header is `columns`.
    pub(super) fn rows(&self, columns: &[&str]) -> Rows {
        let header = render(columns);
        let mut found = Rows::default();
        let mut inside = false;
        for (line, text) in self.lines.iter().enumerate() {
            if !text.starts_with('|') {
                inside = false;
            } else if *text == header {
                inside = true;
            } else if inside && !is_rule(text) {
                let cells = cells(text);
                if cells.len() != columns.len() || render(&cells) != *text {
                    found.untidy.push(line);
                }
                let names = columns.iter().map(|it| (*it).to_owned());
                found.rows.push(Row {
                    line,
                    cells: names.zip(cells).collect(),
                });
            }
        }
        found
    }
}

fn is_rule(line: &str) -> bool {
    cells(line).iter().all(|cell| cell == "---")
}

/// The cells of a line; `\|` is not a border.
fn cells(line: &str) -> Vec<String> {
    let inner = line.trim().trim_start_matches('|');
    let inner = inner.strip_suffix('|').unwrap_or(inner);
    let mut cells = vec![String::new()];
    let mut before = ' ';
    for char in inner.chars() {
        match cells.last_mut() {
            Some(cell) if char != '|' || before == '\\' => cell.push(char),
            _ => cells.push(String::new()),
        }
        before = char;
    }
    cells.iter().map(|cell| cell.trim().to_owned()).collect()
}

/// A line of these cells.
pub(super) fn render<S: AsRef<str>>(cells: &[S]) -> String {
    let mut line = String::from("|");
    for cell in cells {
        line.push(' ');
        line.push_str(cell.as_ref());
        line.push_str(" |");
    }
    line
}

/// A text as a cell.
pub(super) fn escaped(text: &str) -> String {
    text.replace('|', "\\|")
}
