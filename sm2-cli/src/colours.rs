//! Colours on a terminal, where they carry meaning: they add nothing that the words do not say.

use std::{
    env, fmt,
    io::{self, IsTerminal},
};

use anstyle::{AnsiColor, Style};

/// The meaning of a coloured text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Meaning {
    /// It works.
    Good,
    /// It works, and asks for attention.
    Warning,
    /// It does not work.
    Bad,
}

impl Meaning {
    /// The meaning of a sentence about a link: those that begin with `But` say why no message gets through.
    pub(crate) fn of_sentence(sentence: &str) -> Option<Self> {
        let first = sentence.split_whitespace().next()?;
        match first {
            "But" => Some(Self::Bad),
            "Note:" => Some(Self::Warning),
            _ => None,
        }
    }

    /// The text in the colour of its meaning.
    pub(crate) fn paint(self, text: &str) -> impl fmt::Display {
        let colour = match self {
            Self::Good => AnsiColor::Green,
            Self::Warning => AnsiColor::Yellow,
            Self::Bad => AnsiColor::Red,
        };
        let style = Style::new().fg_color(Some(colour.into()));
        format!("{style}{text}{style:#}")
    }
}

/// Whether this stream is a terminal that shows colours, and its user wants them.
pub(crate) fn are_on(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && are_wanted()
}

/// Whether standard error shows colours.
pub(crate) fn are_on_stderr() -> bool {
    are_on(&io::stderr())
}

/// Whether the terminal shows colours, and its user wants them (<https://no-color.org>).
pub(crate) fn are_wanted() -> bool {
    let unwanted = env::var_os("NO_COLOR").is_some_and(|it| !it.is_empty());
    let terminal = env::var("TERM").unwrap_or_default();
    !unwanted && knows_colours(&terminal)
}

/// Whether a terminal with this name shows colours. Terminals without them are few, and their names are old.
fn knows_colours(terminal: &str) -> bool {
    let is_without = ["", "dumb"].contains(&terminal)
        || terminal.starts_with("vt")
        || ["-m", "-mono"].iter().any(|it| terminal.ends_with(it));
    !is_without
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_terminals_have_no_colours() {
        for name in [
            "xterm",
            "xterm-256color",
            "linux",
            "screen",
            "tmux-256color",
        ] {
            assert!(knows_colours(name), "{name}");
        }
        for name in ["", "dumb", "vt100", "vt220", "xterm-mono", "linux-m"] {
            assert!(!knows_colours(name), "{name}");
        }
    }

    #[test]
    fn sentences_of_trouble_have_a_meaning() {
        let meaning = Meaning::of_sentence;
        assert_eq!(meaning("But it takes nothing."), Some(Meaning::Bad));
        assert_eq!(meaning("Note: some were lost."), Some(Meaning::Warning));
        assert_eq!(meaning("Butter is linked."), None);
        assert_eq!(meaning(""), None);
    }
}
