//! The numbers of checks, for each group, engine and property.

use super::Engine;
use super::register::{Register, counted};
use super::table::render;

/// The tables: the checks of each group, of each engine and of each property.
#[must_use]
pub fn summary(register: &Register) -> String {
    let mut lines = Vec::new();
    head(&mut lines, &["group", "claim", "checks"]);
    for group in register.groups() {
        let shows = |names: &[String]| names.iter().any(|name| group.has(name));
        let checks = counted(register.checks().iter().filter(|it| shows(&it.shows)));
        lines.push(render(&[&group.prefixes, &group.shown, &checks]));
    }
    lines.push(String::new());
    head(&mut lines, &["engine", "checks"]);
    for (engine, _) in register.engines() {
        lines.push(render(&[engine, &number(register, engine)]));
    }
    lines.push(String::new());
    head(&mut lines, &["property", "shown by"]);
    for property in register.properties() {
        let shown_by = register.shown_by(&property.name);
        lines.push(render(&[&property.name, &shown_by]));
    }
    lines.join("\n")
}

fn head<const COLUMNS: usize>(lines: &mut Vec<String>, names: &[&str; COLUMNS]) {
    lines.extend([render(names), render(&["---"; COLUMNS])]);
}

/// `31, 12 of them exhaustive`.
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
        (all, exhaustive) => format!("{all}, {exhaustive} of them exhaustive"),
    }
}
