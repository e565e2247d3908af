//! The recent rates of topics and nodes, and their sparklines.

use std::collections::{BTreeMap, VecDeque};

use ratatui::symbols::bar;

use super::{
    figures::{Figures, Tab},
    table::Table,
};

/// How many intervals are kept: those of two minutes, unless `--interval` is given.
const KEPT: usize = 120;

/// Blocks from the lowest to the highest one, which leaves a gap to the row above.
const BLOCKS: [&str; 7] = [
    bar::ONE_EIGHTH,
    bar::ONE_QUARTER,
    bar::THREE_EIGHTHS,
    bar::HALF,
    bar::FIVE_EIGHTHS,
    bar::THREE_QUARTERS,
    bar::SEVEN_EIGHTHS,
];

/// The rates of the last intervals.
#[derive(Clone, Debug, Default)]
pub(super) struct History {
    topics: Rates,
    nodes: Rates,
}

/// Messages per second by name, the newest last. `None` is an interval whose rate is not known.
type Rates = BTreeMap<String, VecDeque<Option<f64>>>;

impl History {
    /// Adds the rates of an interval. Topics and nodes that are gone are forgotten.
    pub(super) fn add(&mut self, figures: &Figures) {
        add(&mut self.topics, &figures.topics);
        add(&mut self.nodes, &figures.nodes);
    }

    /// The last `width` rates of a topic or a node, one block each. The highest block is the largest of them, and an
    /// unknown rate is a blank.
    pub(super) fn sparkline(&self, tab: Tab, name: &str, width: usize) -> String {
        let rates = match tab {
            Tab::Topics => self.topics.get(name),
            Tab::Nodes => self.nodes.get(name),
        };
        let Some(rates) = rates else {
            return String::new();
        };
        let shown = rates.range(rates.len().saturating_sub(width)..);
        let largest = shown.clone().flatten().copied().fold(0.0, f64::max);
        let block = |rate: &Option<f64>| match rate {
            None => " ",
            Some(rate) => {
                let level = rate / largest * (BLOCKS.len() - 1) as f64;
                // 0 without any message: then the level is not a number.
                BLOCKS[level.round() as usize]
            }
        };
        shown.map(block).collect()
    }
}

fn add(rates: &mut Rates, table: &Table) {
    let mut before = std::mem::take(rates);
    for row in &table.rows {
        let Some(name) = row.first() else { continue };
        let name = name.as_text();
        let mut kept = before.remove(name).unwrap_or_default();
        if kept.len() == KEPT {
            kept.pop_front();
        }
        kept.push_back(table.rate(row));
        rates.insert(name.to_owned(), kept);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::top::state::tests::figures;
    use crate::top::table::Cell;

    /// The history of intervals with these rates of the topic `scan`.
    fn history(rates: &[Option<f64>]) -> History {
        let mut history = History::default();
        for rate in rates {
            let mut figures = figures();
            figures.topics.rows[1][1] = Cell::Number(*rate);
            history.add(&figures);
        }
        history
    }

    #[test]
    fn the_largest_rate_has_the_highest_block() {
        let history = history(&[Some(0.0), Some(50.0), None, Some(100.0)]);
        assert_eq!(history.sparkline(Tab::Topics, "scan", 9), "▁▄ ▇");
        assert_eq!(history.sparkline(Tab::Topics, "scan", 2), " ▇");
        assert_eq!(history.sparkline(Tab::Topics, "tf", 9), "    ");
        assert_eq!(history.sparkline(Tab::Nodes, "talker", 9), "▇▇▇▇");
        assert_eq!(history.sparkline(Tab::Topics, "talker", 9), "");
    }

    #[test]
    fn a_topic_without_messages_is_flat() {
        let history = history(&[Some(0.0), Some(0.0)]);
        assert_eq!(history.sparkline(Tab::Topics, "scan", 9), "▁▁");
    }

    #[test]
    fn old_rates_and_names_that_are_gone_are_forgotten() {
        let mut history = history(&[Some(1.0); KEPT + 1]);
        let sparkline = history.sparkline(Tab::Topics, "scan", usize::MAX);
        assert_eq!(sparkline.chars().count(), KEPT);
        history.add(&Figures::default());
        assert_eq!(history.sparkline(Tab::Topics, "scan", 9), "");
        assert!(history.topics.is_empty() && history.nodes.is_empty());
    }
}
