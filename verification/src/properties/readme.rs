//! The tables in README.md, generated from PROPERTIES.md.

use super::register::{Register, counted};
use super::table::render;
use super::{Engine, GapKind};

/// The line before the tables in README.md.
const BEGIN: &str = "<!-- verification:begin -->";
/// The line after them.
const END: &str = "<!-- verification:end -->";

/// The tables: the claims by group, and the strength of each engine.
#[must_use]
pub fn readme_table(register: &Register) -> String {
    let mut lines = vec![
        render(&["", "claim", "checks", "bound"]),
        render(&["---"; 4]),
    ];
    for group in register.groups() {
        let shows = |names: &[String]| names.iter().any(|name| group.has(name));
        let checks = counted(register.checks().iter().filter(|it| shows(&it.shows)));
        lines.push(render(&[
            &group.prefixes,
            &group.shown,
            &checks,
            &group.bound,
        ]));
    }
    lines.push(String::new());
    lines.push(render(&["engine", "strength of the result", "checks"]));
    lines.push(render(&["---"; 3]));
    for (engine, worth) in register.engines() {
        lines.push(render(&[engine, worth, &number(register, engine)]));
    }
    lines.join("\n")
}

/// `31, of which 12 exhaustive`.
fn number(register: &Register, engine: &str) -> String {
    let Some(engine) = Engine::named(engine) else {
        return String::from("none");
    };
    let all = register.checks().iter().filter(|it| it.engine == engine);
    let exhaustive = all
        .clone()
        .filter(|it| it.strength.as_deref() == Some("Exhaustive"));
    match (all.count(), exhaustive.count()) {
        (0, _) => String::from("none"),
        (all, 0) => all.to_string(),
        (all, exhaustive) => format!("{all}, of which {exhaustive} exhaustive"),
    }
}

/// A README.md with `table` between its markers.
///
/// # Errors
/// There are no markers.
pub fn with_table(readme: &str, table: &str) -> Result<String, GapKind> {
    let parts = readme.split_once(BEGIN).and_then(|(before, rest)| {
        let (_, after) = rest.split_once(END)?;
        Some((before, after))
    });
    let (before, after) = parts.ok_or(GapKind::NoMarkers(BEGIN, END))?;
    Ok(format!("{before}{BEGIN}\n{table}\n{END}{after}"))
}
