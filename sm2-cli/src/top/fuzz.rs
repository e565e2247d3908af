//! What a fuzz target checks of the tables.

use sm2_proto::Name;

use super::figures::Figures;
use crate::{sampling::Sample, view::View};

/// All tables between two samples: each row has its cells, JSON has the same, and no cell does
/// anything to a terminal.
pub(crate) fn figures(view: &View<'_>, before: &Sample, now: &Sample) {
    let Ok(itself) = Name::new("a") else {
        return;
    };
    let figures = Figures::new(view, before, now, &itself);
    for table in [&figures.topics, &figures.nodes] {
        for row in &table.rows {
            assert_eq!(row.len(), table.columns.len());
            for (column, cell) in table.columns.iter().zip(row) {
                let shown = column.show(cell);
                assert!(
                    !shown.is_empty() && !shown.contains(char::is_control),
                    "{shown:?}"
                );
                // No count and no delay is below zero.
                assert!(!shown.starts_with('-') || shown == "-" || column.heading == "PID");
            }
        }
        for one in &table.rows {
            for other in &table.rows {
                for (one, other) in one.iter().zip(other) {
                    assert_eq!(one.order(other), other.order(one).reverse());
                }
            }
        }
    }
    assert!(figures.json().is_object());
}
