//! The variable `SM2_LOG`, which all programs read.

use std::env::{self, VarError};

const VARIABLE: &str = "SM2_LOG";
const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];

/// `SM2_LOG` has a value that says no level.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "SM2_LOG is {0:?}: use error, warn, info, debug, trace or off, or levels of single modules, such as \
     warn,sm2_node=debug"
)]
pub struct WrongLogLevel(String);

/// The levels of the log: those of `SM2_LOG` or, if it is not set or empty, `default`. Levels are separated by commas;
/// each is for all modules, or for one as in `sm2_node=debug`.
///
/// # Errors
///
/// [`WrongLogLevel`].
pub fn log_levels(default: &str) -> Result<String, WrongLogLevel> {
    levels_of(env::var(VARIABLE), default)
}

fn levels_of(value: Result<String, VarError>, default: &str) -> Result<String, WrongLogLevel> {
    match value {
        Err(VarError::NotPresent) => Ok(default.to_owned()),
        Ok(levels) if levels.is_empty() => Ok(default.to_owned()),
        Ok(levels) if are_levels(&levels) => Ok(levels),
        Ok(levels) => Err(WrongLogLevel(levels)),
        Err(VarError::NotUnicode(levels)) => {
            Err(WrongLogLevel(levels.to_string_lossy().into_owned()))
        }
    }
}

fn are_levels(text: &str) -> bool {
    let is_level = |it: &str| LEVELS.contains(&it.to_ascii_lowercase().as_str());
    let is_module = |it: &str| {
        let is_char = |c: char| c.is_ascii_alphanumeric() || "_:-".contains(c);
        !it.is_empty() && it.chars().all(is_char)
    };
    text.split(',').all(|part| match part.split_once('=') {
        None => is_level(part),
        Some((module, level)) => is_module(module) && is_level(level),
    })
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::os::unix::ffi::OsStringExt;

    use super::*;

    #[test]
    fn the_variable_comes_before_the_default_unless_it_is_empty_or_wrong() {
        let levels = |value: &str| levels_of(Ok(value.to_owned()), "warn");
        assert_eq!(
            levels_of(Err(VarError::NotPresent), "warn").unwrap(),
            "warn"
        );
        assert_eq!(levels("").unwrap(), "warn");
        assert_eq!(levels("debug").unwrap(), "debug");
        let wrong = levels("verbose").unwrap_err().to_string();
        assert!(
            wrong.starts_with("SM2_LOG is \"verbose\": use error,"),
            "{wrong}"
        );
        let bytes = OsString::from_vec(vec![b'a', 0xff]);
        let wrong = levels_of(Err(VarError::NotUnicode(bytes)), "warn").unwrap_err();
        assert!(wrong.to_string().starts_with("SM2_LOG is \"a"), "{wrong}");
    }

    #[test]
    fn levels_are_known_words() {
        for text in [
            "warn",
            "INFO",
            "off",
            "warn,sm2_node=debug",
            "sm2_io::socket=trace",
        ] {
            assert!(are_levels(text), "{text}");
        }
        for text in [
            "",
            "verbose",
            "no=such=level",
            "info,",
            "=info",
            "sm2_node",
            "a b=info",
        ] {
            assert!(!are_levels(text), "{text}");
        }
    }
}
