//! The output of a run of all tests: their results need no second run.

use std::env;
use std::fs;
use std::io;

/// The variable with the path of the output of `cargo test --workspace`, of these sources and without a failure.
const TESTED: &str = "SM2_TESTED";

/// The output of `cargo test --workspace`.
pub(crate) struct Tested(pub(crate) String);

impl Tested {
    /// Reads the output that the caller names; `None` if it names none.
    pub(crate) fn read() -> io::Result<Option<Self>> {
        let path = env::var_os(TESTED);
        path.map(fs::read_to_string)
            .transpose()
            .map(|it| it.map(Self))
    }

    /// The number of tests that passed in the programs whose first line `is_it`, of those that are `asked` for by
    /// their names.
    fn count(&self, is_it: impl Fn(&str) -> bool, asked: impl Fn(&str) -> bool) -> usize {
        let (mut is_inside, mut passed) = (false, 0);
        for line in self.0.lines().map(str::trim_start) {
            if line.starts_with("Running ") || line.starts_with("Doc-tests ") {
                is_inside = is_it(line);
            }
            let name = line.strip_prefix("test ");
            let name = name.and_then(|it| it.strip_suffix(" ... ok"));
            passed += usize::from(is_inside && name.is_some_and(&asked));
        }
        passed
    }

    /// The number of tests of the libraries that passed, of those that are `asked` for.
    pub(crate) fn passed_in_libraries(&self, asked: impl Fn(&str) -> bool) -> usize {
        self.count(
            |line| line.starts_with("Running unittests src/lib.rs ("),
            asked,
        )
    }

    /// The number of tests of a program that passed, of those that are `asked` for. Cargo adds a hash to the name of
    /// the program.
    pub(crate) fn passed_of(&self, program: &str, asked: impl Fn(&str) -> bool) -> usize {
        let part = format!("/deps/{program}-");
        self.count(
            |line| line.starts_with("Running tests/") && line.contains(&part),
            asked,
        )
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
    fn tests_are_found_below_the_line_of_their_program() {
        let text = "
     Running unittests src/lib.rs (target/debug/deps/a-1)
test words::one ... ok
test other ... ok
     Running unittests src/lib.rs (target/debug/deps/b-1)
test words::two ... ok
     Running tests/main.rs (target/debug/deps/words-1)
test a::one ... ok
test a::two ... FAILED
test b::one ... ok
     Running tests/main.rs (target/debug/deps/other-1)
test a::one ... ok

test result: FAILED. 2 passed; 1 failed; 0 ignored

   Doc-tests a
test one ... ok
";
        let tested = Tested(text.to_owned());
        let in_words = tested.passed_in_libraries(|it| it.contains("words::"));
        assert_eq!(in_words, 2);
        assert_eq!(tested.passed_of("words", |it| it == "a::one"), 1);
        assert_eq!(tested.passed_of("words", |it| it == "a::two"), 0);
        assert_eq!(tested.passed_of("words", |_| true), 2);
        assert_eq!(tested.passed_of("word", |_| true), 0);
    }
}
