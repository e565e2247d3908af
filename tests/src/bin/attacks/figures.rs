//! The figures of windows, and the table.

use sm2_tests::actor::number;

/// The heading of the table.
pub(crate) const HEADER: &str = "\
| attack | messages per second | p99 of the delay, µs | lost | p99 of a new link, ms |
| --- | --- | --- | --- | --- |";

/// The figures of one window.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    rate_hz: u64,
    p99_us: u64,
    lost: u64,
    damaged: u64,
    new_links_p99_us: u64,
}

/// The windows of one attack.
#[derive(Debug, Default)]
pub(crate) struct Row {
    pub(crate) without: Vec<Window>,
    pub(crate) with: Vec<Window>,
}

impl Window {
    /// The figures that the subscriber and the newcomer have reported.
    pub(crate) fn parse(subscriber: &str, newcomer: &str) -> Self {
        Self {
            rate_hz: number(subscriber, "hz"),
            p99_us: number(subscriber, "p99_us"),
            lost: number(subscriber, "lost"),
            damaged: number(subscriber, "damaged"),
            new_links_p99_us: number(newcomer, "p99_us"),
        }
    }
}

impl Row {
    /// Whether each window has messages, and all of them are intact.
    pub(crate) fn is_good(&self) -> bool {
        let mut all = self.without.iter().chain(&self.with);
        all.all(|it| it.rate_hz > 0 && it.damaged == 0)
    }

    /// The row of the table.
    pub(crate) fn markdown(&self, name: &str) -> String {
        let cell = |of: fn(&Window) -> u64| {
            let [without, with] = [&self.without, &self.with].map(|it| range(it.iter().map(of)));
            format!("{without} → {with}")
        };
        let links = |windows: &[Window]| {
            let ms = windows.iter().map(|it| it.new_links_p99_us as f64 / 1e3);
            let (least, greatest) = ms.fold((f64::MAX, 0.0_f64), |(least, greatest), it| {
                (least.min(it), greatest.max(it))
            });
            format!("{least:.1} to {greatest:.1}")
        };
        format!(
            "| {name} | {} | {} | {} | {} → {} |",
            cell(|it| it.rate_hz),
            cell(|it| it.p99_us),
            cell(|it| it.lost),
            links(&self.without),
            links(&self.with)
        )
    }
}

fn range(values: impl Iterator<Item = u64> + Clone) -> String {
    let (least, greatest) = (values.clone().min(), values.max());
    match (least.unwrap_or(0), greatest.unwrap_or(0)) {
        (least, greatest) if least == greatest => format!("{least}"),
        (least, greatest) => format!("{least} to {greatest}"),
    }
}

#[cfg(test)]
mod tests {
    use super::{Row, Window};

    fn window(hz: u64, damaged: u64) -> Window {
        let subscriber = format!("hz={hz} p99_us=90 lost=0 damaged={damaged}");
        Window::parse(&subscriber, "p99_us=1500")
    }

    #[test]
    fn a_row_has_the_ranges_of_both_kinds_of_windows() {
        let row = Row {
            without: vec![window(200, 0), window(190, 0)],
            with: vec![window(180, 0)],
        };
        let expected = "| flood | 190 to 200 → 180 | 90 → 90 | 0 → 0 | 1.5 to 1.5 → 1.5 to 1.5 |";
        assert_eq!(row.markdown("flood"), expected);
        assert!(row.is_good());
    }

    #[test]
    fn no_messages_and_damage_are_not_good() {
        for bad in [window(0, 0), window(200, 1)] {
            let row = Row {
                without: vec![window(200, 0)],
                with: vec![bad],
            };
            assert!(!row.is_good(), "{bad:?}");
        }
    }
}
