//! The body of a fuzz target: the tables of `sm2 top`.

use sm2_proto::Name;

use super::figures::Figures;
use crate::{
    observation::Readings, process::ProcessorUse, sampling::Sample, troubles::LinkTroubles,
    view::View,
};

/// Builds all tables from two samples. Each row has a cell for every column, no cell contains a control
/// character, and the tables can be written as JSON.
pub(crate) fn figures(view: &View<'_>, before: &Sample, now: &Sample) {
    let Ok(itself) = Name::new("a") else {
        return;
    };
    let readings = Readings {
        before: Some(before),
        now,
    };
    let figures = Figures::new(view, readings, &ProcessorUse::default(), &itself);
    let troubles = LinkTroubles::of_all(view, readings);
    assert!(
        troubles
            .lines()
            .all(|line| !line.contains(char::is_control))
    );
    for table in [&figures.topics, &figures.nodes] {
        for row in &table.rows {
            assert_eq!(row.len(), table.columns.len());
            for (column, cell) in table.columns.iter().zip(row) {
                let shown = column.show(cell);
                assert!(
                    !shown.is_empty() && !shown.contains(char::is_control),
                    "{shown:?}"
                );
                // Counts and delays are never negative.
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
