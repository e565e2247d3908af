//! Chooses topics by patterns: globs and regular expressions.

use glob::MatchOptions;
use regex_lite::Regex;

use crate::foreign::topic_name;

/// Names are compared as they are, segment by segment.
const OPTIONS: MatchOptions = MatchOptions {
    case_sensitive: true,
    require_literal_separator: true,
    require_literal_leading_dot: false,
};

/// A pattern for topics.
#[derive(Clone, Debug)]
pub struct Pattern {
    text: String,
    matcher: Matcher,
}

#[derive(Clone, Debug)]
enum Matcher {
    Glob(glob::Pattern),
    Regex(Regex),
}

/// Why a text is not a pattern.
#[derive(Debug, thiserror::Error)]
pub enum PatternError {
    /// It is not a glob.
    #[error(transparent)]
    Glob(#[from] glob::PatternError),
    /// It is not a regular expression.
    #[error(transparent)]
    Regex(#[from] regex_lite::Error),
}

impl Pattern {
    /// Whether a text is a glob and not a name: no name has one of these characters.
    #[must_use]
    pub fn is_glob(text: &str) -> bool {
        text.contains(['*', '?', '['])
    }

    /// A pattern as in shells: `*` stands for characters other than `/`, `?` for one of them, `**` for whole segments,
    /// and `[ab]` for one of the characters. A name is a pattern for itself.
    ///
    /// # Errors
    ///
    /// [`PatternError::Glob`].
    pub fn glob(text: &str) -> Result<Self, PatternError> {
        let matcher = Matcher::Glob(glob::Pattern::new(topic_name(text))?);
        let text = text.to_owned();
        Ok(Self { text, matcher })
    }

    /// A regular expression for the whole name, with the syntax of the crate `regex-lite`.
    ///
    /// # Errors
    ///
    /// [`PatternError::Regex`].
    pub fn regex(text: &str) -> Result<Self, PatternError> {
        // Parsed alone first, so that its brackets cannot close those around it.
        Regex::new(text)?;
        let matcher = Matcher::Regex(Regex::new(&format!("^(?:{text})$"))?);
        let text = text.to_owned();
        Ok(Self { text, matcher })
    }

    /// The text of the pattern.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// Whether a topic matches, with or without the slash at its start that bags of ROS 2 have.
    #[must_use]
    pub fn matches(&self, topic: &str) -> bool {
        let name = topic_name(topic);
        match &self.matcher {
            Matcher::Glob(it) => it.matches_with(name, OPTIONS),
            Matcher::Regex(it) => it.is_match(name) || it.is_match(topic),
        }
    }
}

/// Topics that are chosen by patterns. The default chooses all.
#[derive(Clone, Debug, Default)]
pub struct TopicPatterns {
    /// A topic matches one of these; empty for all topics.
    pub include: Vec<Pattern>,
    /// A topic matches none of these.
    pub exclude: Vec<Pattern>,
}

impl TopicPatterns {
    /// Whether they choose a topic.
    #[must_use]
    pub fn choose(&self, topic: &str) -> bool {
        (self.include.is_empty() || self.include(topic)) && !self.exclude(topic)
    }

    /// Whether one of them includes a topic.
    pub(crate) fn include(&self, topic: &str) -> bool {
        self.include.iter().any(|it| it.matches(topic))
    }

    /// Whether they exclude a topic.
    pub(crate) fn exclude(&self, topic: &str) -> bool {
        self.exclude.iter().any(|it| it.matches(topic))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_matches_whole_names() {
        let glob = |text: &str| Pattern::glob(text).unwrap();
        let regex = |text: &str| Pattern::regex(text).unwrap();
        for (pattern, yes, no) in [
            (
                glob("camera/*"),
                &["camera/left", "/camera/left"][..],
                &["camera", "camera/left/raw"][..],
            ),
            (
                glob("/camera/**"),
                &["camera/left", "camera/left/raw"],
                &["cameras/left"],
            ),
            (glob("**/raw"), &["raw", "a/b/raw"], &["a/raw2"]),
            (
                glob("scan?"),
                &["scan1", "scanx"],
                &["scan", "scan12", "scan/"],
            ),
            (glob("scan"), &["scan", "/scan"], &["scan2"]),
            (
                regex(r"camera/\d+"),
                &["camera/12", "/camera/1"],
                &["camera/12x", "a/camera/1"],
            ),
            (regex("a|b"), &["a", "b"], &["ab", "ac"]),
        ] {
            for topic in yes {
                assert!(pattern.matches(topic), "{pattern:?} {topic}");
            }
            for topic in no {
                assert!(!pattern.matches(topic), "{pattern:?} {topic}");
            }
        }
        for wrong in ["[", "a**"] {
            assert!(Pattern::glob(wrong).is_err(), "{wrong}");
        }
        for wrong in ["(", "a)|(b"] {
            assert!(Pattern::regex(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn exclusion_wins() {
        let patterns = |include: &[&str], exclude: &[&str]| {
            let all = |texts: &[&str]| texts.iter().map(|it| Pattern::glob(it).unwrap()).collect();
            TopicPatterns {
                include: all(include),
                exclude: all(exclude),
            }
        };
        assert!(TopicPatterns::default().choose("scan"));
        assert!(!patterns(&[], &["scan"]).choose("scan"));
        assert!(patterns(&[], &["scan"]).choose("imu"));
        assert!(patterns(&["s*", "imu"], &["*2"]).choose("scan"));
        assert!(!patterns(&["s*", "imu"], &["*2"]).choose("scan2"));
        assert!(!patterns(&["s*", "imu"], &["*2"]).choose("map"));
    }
}
