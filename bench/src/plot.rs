//! Plots of results: lines if the labels of the cases are numbers, otherwise bars.

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use plotters::{
    coord::Shift,
    prelude::{
        BLACK, Cartesian2d, ChartBuilder, DrawingArea, EmptyElement, IntoDrawingArea, IntoFont,
        IntoLogRange, LineSeries, PathElement, Rectangle, SVGBackend, Text, WHITE,
    },
    style::{Color, Palette99, PaletteColor, RGBColor, ShapeStyle},
};

use crate::{
    results::{PeerFigure, Results, join},
    workloads,
};

type Drawing<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The least number of cases that are plotted as lines.
const LINE_CASES: usize = 3;

/// Figures without a plot: checks that everything arrived, values for comparison, and figures that
/// follow from another one.
const PLAIN: [&str; 9] = [
    "dropped",
    "lost",
    "torn",
    "stale",
    "remote_share",
    "remote_hz",
    "local_hz_before",
    "local_latency_p99_before",
    "local_dropped",
];

/// A plot of one figure over the cases.
struct Plot<'a> {
    results: &'a Results,
    figure: &'static str,
    /// The labels of the cases, and the number in each label.
    cases: Vec<(String, Option<f64>)>,
}

/// The names of the files that [`draw`] makes.
#[must_use]
pub fn names(results: &Results) -> Vec<String> {
    plots(results).iter().map(Plot::file_name).collect()
}

/// Draws all plots of a run into this folder.
///
/// # Errors
///
/// The folder cannot be written to.
pub fn draw(results: &Results, dir: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    fs::create_dir_all(dir)?;
    let mut paths = Vec::new();
    for plot in plots(results) {
        let path = dir.join(plot.file_name());
        plot.draw(&path)?;
        paths.push(path);
    }
    Ok(paths)
}

fn plots(results: &Results) -> Vec<Plot<'_>> {
    let shown = workloads::find(&results.workload).map_or(&[][..], |workload| workload.shown);
    let figures = shown.iter().filter(|figure| !PLAIN.contains(figure));
    let plot = |&figure: &&'static str| {
        let cases = results.cases().into_iter();
        let cases = cases.filter(|case| {
            let name = join(case, figure);
            let mut all = results.figures.iter();
            all.any(|known| known.figure == name && known.summary.median > 0.0)
        });
        let cases: Vec<_> = cases.map(|case| (case.clone(), leading(&case))).collect();
        let plot = Plot {
            results,
            figure,
            cases,
        };
        (!plot.cases.is_empty()).then_some(plot)
    };
    figures.filter_map(plot).collect()
}

/// The number in a case's label: `800Hz`, `1to5`, `64B`, `100nodes`.
fn leading(case: &str) -> Option<f64> {
    let digits = case.strip_prefix("1to").unwrap_or(case);
    let end = digits
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(digits.len());
    digits[..end].parse().ok()
}

impl Plot<'_> {
    fn file_name(&self) -> String {
        let Results { workload, read, .. } = self.results;
        format!("{workload}-{}-{}.svg", read.as_str(), self.figure)
    }

    fn find(&self, peer: &str, case: &str) -> Option<&PeerFigure> {
        let found = self.results.find(peer, &join(case, self.figure));
        // Zero has no logarithm.
        found.filter(|figure| figure.summary.min > 0.0)
    }

    fn unit(&self) -> &str {
        let name = join(&self.cases[0].0, self.figure);
        let mut all = self.results.figures.iter();
        let figure = all.find(|figure| figure.figure == name);
        figure.map_or("", |figure| &figure.unit)
    }

    fn title(&self) -> String {
        let Results { workload, read, .. } = self.results;
        format!(
            "{workload}, read {}: {}, {}",
            read.as_str(),
            self.figure,
            self.unit()
        )
    }

    /// The range of the axis: the least and the greatest value, with a margin.
    fn range(&self) -> (f64, f64) {
        let (mut least, mut greatest) = (f64::INFINITY, f64::MIN_POSITIVE);
        for peer in self.results.peers() {
            for (case, _) in &self.cases {
                if let Some(figure) = self.find(peer, case) {
                    least = least.min(figure.summary.min);
                    greatest = greatest.max(figure.summary.max);
                }
            }
        }
        (least.min(greatest) / 1.5, greatest * 1.5)
    }

    fn draw(&self, path: &Path) -> Result<(), Box<dyn Error>> {
        let points: Vec<_> = self
            .cases
            .iter()
            .filter_map(|(case, number)| Some((case.clone(), (*number)?)))
            .collect();
        if points.len() >= LINE_CASES {
            self.lines(path, &points)
        } else {
            self.bars(path)
        }
    }

    fn lines(&self, path: &Path, points: &[(String, f64)]) -> Result<(), Box<dyn Error>> {
        let drawing = SVGBackend::new(path, (860, 520)).into_drawing_area();
        drawing.fill(&WHITE)?;
        let numbers = points.iter().map(|(_, number)| *number);
        let (first, last) = numbers.fold((f64::INFINITY, 0.0_f64), |(first, last), number| {
            (first.min(number), last.max(number))
        });
        let (least, greatest) = self.range();
        let mut chart = ChartBuilder::on(&drawing)
            .caption(self.title(), ("sans-serif", 18).into_font())
            .margin(10)
            .margin_right(200)
            .x_label_area_size(40)
            .y_label_area_size(80)
            .build_cartesian_2d(
                (first * 0.9..last * 1.1).log_scale(),
                (least..greatest).log_scale(),
            )?;
        let label = |value: &f64| tick(*value);
        chart
            .configure_mesh()
            .x_labels(6)
            .x_label_formatter(&label)
            .y_label_formatter(&label)
            .x_desc(axis(&points[0].0))
            .y_desc(self.unit())
            .light_line_style(WHITE)
            .draw()?;
        for (at, peer) in self.results.peers().into_iter().enumerate() {
            let line: Vec<_> = points
                .iter()
                .filter_map(|(case, number)| Some((*number, self.find(peer, case)?.summary.median)))
                .collect();
            let style = colour(at).stroke_width(2);
            chart.draw_series(LineSeries::new(line, style).point_size(3))?;
            legend(&drawing, at, peer, style)?;
        }
        drawing.present()?;
        Ok(())
    }

    fn bars(&self, path: &Path) -> Result<(), Box<dyn Error>> {
        let mut bars = Vec::new();
        for (case, _) in &self.cases {
            for peer in self.results.peers() {
                if let Some(figure) = self.find(peer, case) {
                    bars.push((format!("{case} {peer}").trim().to_owned(), peer, figure));
                }
            }
        }
        let height = 90 + 24 * bars.len();
        let drawing = SVGBackend::new(path, (860, height as u32)).into_drawing_area();
        drawing.fill(&WHITE)?;
        let (least, greatest) = self.range();
        let rows = bars.len() as f64;
        let mut chart = ChartBuilder::on(&drawing)
            .caption(self.title(), ("sans-serif", 18).into_font())
            .margin(10)
            .margin_left(220)
            .margin_right(80)
            .x_label_area_size(36)
            .build_cartesian_2d((least..greatest).log_scale(), 0.0..rows)?;
        let label = |value: &f64| tick(*value);
        chart
            .configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .x_label_formatter(&label)
            .light_line_style(WHITE)
            .draw()?;
        let peers = self.results.peers();
        for (row, (name, peer, figure)) in bars.iter().enumerate() {
            let at = peers.iter().position(|known| known == peer).unwrap_or(0);
            bar(
                &mut chart,
                (least, rows - row as f64 - 0.5),
                name,
                at,
                figure,
            )?;
        }
        drawing.present()?;
        Ok(())
    }
}

type Chart<'a, 'b, X, Y> = plotters::chart::ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>;

/// Draws a bar from the left edge to the median, with its range, its name and its value.
fn bar<X, Y>(
    chart: &mut Chart<'_, '_, X, Y>,
    (left, middle): (f64, f64),
    name: &str,
    at: usize,
    figure: &PeerFigure,
) -> Result<(), Box<dyn Error>>
where
    X: plotters::coord::ranged1d::Ranged<ValueType = f64>,
    Y: plotters::coord::ranged1d::Ranged<ValueType = f64>,
{
    let summary = figure.summary;
    let corners = [(left, middle - 0.35), (summary.median, middle + 0.35)];
    let fill = colour(at).mix(0.6).filled();
    chart.draw_series([Rectangle::new(corners, fill)])?;
    let range = vec![(summary.min, middle), (summary.max, middle)];
    chart.draw_series([PathElement::new(range, BLACK.stroke_width(1))])?;
    let font = || ("sans-serif", 13).into_font();
    let (name, value) = (name.to_owned(), crate::format::number(summary.median));
    chart.draw_series([EmptyElement::at((left, middle)) + Text::new(name, (-212, -6), font())])?;
    chart.draw_series([
        EmptyElement::at((summary.max, middle)) + Text::new(value, (6, -6), font())
    ])?;
    Ok(())
}

fn legend(
    drawing: &Drawing<'_>,
    at: usize,
    name: &str,
    style: ShapeStyle,
) -> Result<(), Box<dyn Error>> {
    let (x, y) = (670, 50 + 20 * at as i32);
    drawing.draw(&PathElement::new(vec![(x, y), (x + 22, y)], style))?;
    let font = ("sans-serif", 13).into_font();
    drawing.draw(&Text::new(name.to_owned(), (x + 28, y - 6), font))?;
    Ok(())
}

/// The colour of a peer: black for the reference, otherwise one of the palette.
fn colour(at: usize) -> RGBColor {
    let (red, green, blue) = match at {
        0 => (0, 0, 0),
        at => PaletteColor::<Palette99>::pick(at).to_backend_color().rgb,
    };
    RGBColor(red, green, blue)
}

/// The label of a value at an axis, without trailing zeros.
fn tick(value: f64) -> String {
    let text = crate::format::number(value);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// The description of the axis for cases with this kind of label.
fn axis(case: &str) -> &'static str {
    if case.starts_with("1to") {
        "subscribers"
    } else if case.ends_with("Hz") {
        "target rate, Hz"
    } else if case.ends_with('B') {
        "message length, bytes"
    } else {
        "nodes"
    }
}

#[cfg(test)]
mod tests {
    use super::{draw, leading, names, tick};
    use crate::results::tests::results;

    #[test]
    fn labels_have_numbers() {
        for (case, number) in [
            ("1to5", Some(5.0)),
            ("800Hz", Some(800.0)),
            ("64B", Some(64.0)),
            ("max", None),
            ("", None),
        ] {
            assert_eq!(leading(case), number, "{case}");
        }
    }

    #[test]
    fn ticks_have_no_zeros_that_say_nothing() {
        for (value, text) in [
            (10.0, "10"),
            (0.5, "0.5"),
            (100.0, "100"),
            (1_000.0, "1,000"),
        ] {
            assert_eq!(tick(value), text);
        }
    }

    #[test]
    fn bars_are_drawn_with_names_and_numbers() {
        let dir = tempfile::tempdir().unwrap();
        let results = results();
        let paths = draw(&results, dir.path()).unwrap();
        assert_eq!(names(&results), ["fig3-full-cpu.svg"]);
        let svg = std::fs::read_to_string(&paths[0]).unwrap();
        assert!(svg.contains("1to5 raw-futex") && svg.contains("1.50"));
    }

    #[test]
    fn from_three_cases_on_lines_are_drawn_and_named() {
        let dir = tempfile::tempdir().unwrap();
        let mut results = results();
        results.workload = "fig5".to_owned();
        for (case, value) in [("1to1", 1.0), ("1to2", 2.0), ("1to3", 3.0)] {
            results.record("sm2", &format!("{case}/latency_mean"), "ms", value);
        }
        results.conclude();
        let paths = draw(&results, dir.path()).unwrap();
        let svg = std::fs::read_to_string(&paths[0]).unwrap();
        assert!(svg.contains("polyline") && svg.contains("sm2"));
        assert!(svg.contains("subscribers"));
    }
}
