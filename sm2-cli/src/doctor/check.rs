use serde::Serialize;

use crate::{
    colours::Meaning,
    columns::{Column, Row},
};

/// The severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Level {
    /// No problem was found.
    Ok,
    /// SM2 works, but with limits or with less speed than possible.
    Warn,
    /// SM2 does not work until the problem is solved.
    Bad,
}

impl Level {
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warn => "warn",
            Self::Bad => "bad",
        }
    }

    pub(super) const fn meaning(self) -> Meaning {
        match self {
            Self::Ok => Meaning::Good,
            Self::Warn => Meaning::Warning,
            Self::Bad => Meaning::Bad,
        }
    }
}

/// The result of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Check {
    pub(super) level: Level,
    /// The thing that was checked.
    pub(super) check: &'static str,
    pub(super) found: String,
    /// The remedy; `None` if the check found no problem.
    pub(super) advice: Option<String>,
}

impl Row for Check {
    const COLUMNS: &'static [Column<Self>] = &[
        ("LEVEL", |it| it.level.word().to_owned()),
        ("CHECK", |it| it.check.to_owned()),
        ("FOUND", |it| match &it.advice {
            None => it.found.clone(),
            Some(advice) => format!("{}: {advice}", it.found),
        }),
    ];
}

impl Check {
    pub(super) fn ok(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            level: Level::Ok,
            check,
            found: found.into(),
            advice: None,
        }
    }

    pub(super) fn warn(
        check: &'static str,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            level: Level::Warn,
            check,
            found: found.into(),
            advice: Some(advice.into()),
        }
    }

    /// A warning that lists all that was found, or `ok` with the text `none` if nothing was.
    pub(super) fn warn_of(
        check: &'static str,
        none: impl Into<String>,
        found: impl IntoIterator<Item: ToString>,
        advice: impl Into<String>,
    ) -> Self {
        let found: Vec<_> = found.into_iter().map(|it| it.to_string()).collect();
        match found.is_empty() {
            true => Self::ok(check, none),
            false => Self::warn(check, found.join(", "), advice),
        }
    }

    pub(super) fn bad(
        check: &'static str,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self {
            level: Level::Bad,
            check,
            found: found.into(),
            advice: Some(advice.into()),
        }
    }
}
