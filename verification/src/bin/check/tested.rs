//! The output of a run of all tests: their results need no second run.

use std::env;
use std::fs;
use std::io;

/// The variable with the path of the output of `cargo test --workspace`, of these sources and without a failure.
const TESTED: &str = "SM2_TESTED";

/// The output of `cargo test --workspace`.
pub(crate) struct Tested(String);

impl Tested {
    /// Reads the output that the caller names; `None` if it names none.
    pub(crate) fn read() -> io::Result<Option<Self>> {
        let path = env::var_os(TESTED);
        path.map(fs::read_to_string)
            .transpose()
            .map(|it| it.map(Self))
    }

    /// The lines that the test targets of this source file printed: `tests/NAME.rs`, or `src/lib.rs` of all packages.
    fn lines(&self, file: &str) -> impl Iterator<Item = &str> + use<'_> {
        let starts = [
            format!("Running {file} ("),
            format!("Running unittests {file} ("),
        ];
        let mut is_inside = false;
        self.0.lines().map(str::trim_start).filter(move |line| {
            if line.starts_with("Running ") || line.starts_with("Doc-tests ") {
                is_inside = starts.iter().any(|it| line.starts_with(it));
            }
            is_inside
        })
    }

    /// The number of tests of a source file that passed.
    pub(crate) fn passed(&self, file: &str) -> Option<usize> {
        let passed = self.lines(file).filter_map(passed);
        passed.reduce(|all, count| all + count)
    }

    /// The number of tests of a source file that passed, of those that are `asked` for by their names.
    pub(crate) fn passed_of(&self, file: &str, asked: impl Fn(&str) -> bool) -> usize {
        let name = |line: &str| {
            line.strip_prefix("test ")?
                .strip_suffix(" ... ok")
                .map(&asked)
        };
        self.lines(file).filter(|it| name(it) == Some(true)).count()
    }
}

/// The number of passed tests of a line with the result of a test target.
pub(crate) fn passed(line: &str) -> Option<usize> {
    let (_, rest) = line.split_once("test result: ")?;
    let (_, rest) = rest.split_once(". ")?;
    rest.split_once(" passed")?.0.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::Tested;

    #[test]
    fn tests_are_found_below_the_line_of_their_file() {
        let text = "
     Running unittests src/lib.rs (target/debug/deps/a-1)
test words::one ... ok
test other ... ok
     Running unittests src/lib.rs (target/debug/deps/b-1)
test words::two ... ok
     Running tests/words.rs (target/debug/deps/words-1)
test one ... ok
test two ... FAILED
test one_more ... ok

test result: FAILED. 2 passed; 1 failed; 0 ignored

   Doc-tests a
test one ... ok
";
        let tested = Tested(text.to_owned());
        assert_eq!(
            tested.passed_of("src/lib.rs", |it| it.contains("words::")),
            2
        );
        assert_eq!(tested.passed_of("tests/words.rs", |it| it == "one"), 1);
        assert_eq!(tested.passed("tests/words.rs"), Some(2));
        assert_eq!(tested.passed("tests/two.rs"), None);
    }
}
