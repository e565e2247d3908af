//! One line of results for each harness, which is compared with `PROPERTIES.md`.

use std::env;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;

/// The variable that names the file to append to.
const FILE: &str = "SM2_VERIFICATION_RESULTS";

/// Appends the coverage of a run to that file, if it is named. A run that failed covers nothing.
///
/// # Panics
///
/// If the line cannot be written, because the result would be missing silently.
pub(crate) fn append(harness: &str, covered: Option<&str>, took: Duration) {
    let Some(file) = env::var_os(FILE) else {
        return;
    };
    let line = line(harness, covered, took);
    if let Err(error) = write(Path::new(&file), &line) {
        panic!("{FILE}: {}: {error}", file.display());
    }
}

fn line(harness: &str, covered: Option<&str>, took: Duration) -> String {
    let verdict = if covered.is_some() { "ok" } else { "FAILED" };
    let seconds = took.as_secs_f64();
    let covered = covered.unwrap_or_default();
    format!("stand-in\t{harness}\t{verdict}\t{seconds:.1}\t{covered}\n")
}

/// Writes the whole line at once, because tests run at the same time.
fn write(file: &Path, line: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().create(true).append(true).open(file)?;
    match file.write(line.as_bytes())? {
        written if written == line.len() => Ok(()),
        _ => Err(io::ErrorKind::WriteZero.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_five_fields() {
        let took = Duration::from_millis(1_260);
        assert_eq!(
            line("a::b", Some("Exhaustive, 2 paths, 0 rejected"), took),
            "stand-in\ta::b\tok\t1.3\tExhaustive, 2 paths, 0 rejected\n"
        );
        let failed = line("a::b", None, took);
        assert_eq!(failed, "stand-in\ta::b\tFAILED\t1.3\t\n");
    }

    #[test]
    fn lines_follow_each_other() {
        let file = env::temp_dir().join(format!("sm2-results-{}", std::process::id()));
        for text in ["one\n", "two\n"] {
            write(&file, text).expect("a file");
        }
        let written = std::fs::read_to_string(&file);
        std::fs::remove_file(&file).expect("it is there");
        assert_eq!(written.expect("text"), "one\ntwo\n");
    }
}
