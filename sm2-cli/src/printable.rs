//! Text of others on a terminal.
//!
//! Names in bags, texts of triggers, errors with names in them: any process or file can put control characters there,
//! which a terminal obeys, and characters that change the direction of writing. All lines of the commands show them as
//! escapes.

use std::borrow::Cow;

use crate::text::escaped;

/// Whether a terminal would do something else with a character than show it. Lines may have breaks and tabs.
fn is_unsafe(c: char) -> bool {
    match c {
        '\n' | '\t' => false,
        // The embeddings, overrides and isolates of bidirectional text.
        '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => true,
        c => c.is_control(),
    }
}

/// A text with escapes such as `\u{9b}` in the place of characters that a terminal would obey.
pub(crate) fn printable(text: &str) -> Cow<'_, str> {
    match text.contains(is_unsafe) {
        false => text.into(),
        true => escaped(text, is_unsafe, char::escape_unicode).into(),
    }
}

/// The same for JSON, where such a character can only be in a string.
pub(crate) fn printable_json(json: &str) -> Cow<'_, str> {
    match json.contains(is_unsafe) {
        false => json.into(),
        true => escaped(json, is_unsafe, |c| format!("\\u{:04x}", u32::from(c))).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_reaches_a_terminal_that_it_would_obey() {
        let text = "a\u{1b}[2J\u{9b}31m\u{202e}b\u{2066}\tö\r\n";
        assert_eq!(
            printable(text),
            "a\\u{1b}[2J\\u{9b}31m\\u{202e}b\\u{2066}\tö\\u{d}\n"
        );
        let json = serde_json::to_string(text).unwrap();
        let shown = printable_json(&json);
        assert!(!shown.contains(is_unsafe), "{shown}");
        assert_eq!(serde_json::from_str::<String>(&shown).unwrap(), text);
        for plain in ["", "scan: 3 messages", "ünï\n"] {
            assert!(matches!(printable(plain), Cow::Borrowed(it) if it == plain));
        }
    }
}
