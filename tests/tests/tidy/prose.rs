//! Sentences of comments and documents that readers stumble over.

use std::path::Path;

use super::sources::Finding;

/// A sentence may have this many words at most.
const WORDS_MAX: usize = 40;

/// Words that no sentence of a comment or document begins with, and the advice for each.
///
/// Questions may begin with them, as in a list of frequent questions.
const BEGINNINGS: &[(&[&str], &str)] = &[
    (&["What"], NAME_THE_SUBJECT),
    (&["Whatever"], NAME_THE_SUBJECT),
    (&["Who"], NAME_THE_SUBJECT),
    (&["Whoever"], NAME_THE_SUBJECT),
    (&["Those", "who"], NAME_THE_SUBJECT),
    (&["Those", "that"], NAME_THE_SUBJECT),
    (&["That", "which"], NAME_THE_SUBJECT),
    (&["That", "it"], NAME_THE_SUBJECT),
];

/// Words that stand in no sentence of a comment or document, and the advice for each.
const PHRASES: &[(&[&str], &str)] = &[
    (&["the", "latter"], NAME_IT_AGAIN),
    (&["the", "former"], NAME_IT_AGAIN),
    (&["how", "is", "it"], "state what is requested"),
    (&["in", "vain"], "state what did not happen"),
    (&["as", "ever"], "state what stays the same"),
    (&["goes", "without"], "state what is left out"),
    (&["that", "which"], NAME_THE_SUBJECT),
    (&["by", "who"], NAME_THE_SUBJECT),
    (&["by", "whoever"], NAME_THE_SUBJECT),
    (&["for", "who"], NAME_THE_SUBJECT),
    (&["for", "whoever"], NAME_THE_SUBJECT),
    (&["from", "who"], NAME_THE_SUBJECT),
    (&["from", "whoever"], NAME_THE_SUBJECT),
    (&["of", "who"], NAME_THE_SUBJECT),
    (&["of", "whoever"], NAME_THE_SUBJECT),
    (&["to", "who"], NAME_THE_SUBJECT),
    (&["to", "whoever"], NAME_THE_SUBJECT),
    (&["with", "whoever"], NAME_THE_SUBJECT),
];

/// Words that begin a relative clause together with 'which'.
const PREPOSITIONS: &[&str] = &[
    "of", "for", "by", "in", "on", "to", "at", "from", "with", "whose",
];

const NAME_THE_SUBJECT: &str = "name the thing instead of a clause about it";
const NAME_IT_AGAIN: &str = "name the thing again";

/// The sentences of a Rust file's comments, or of a Markdown file, that break a rule.
///
/// Tables, headings, pictures, code blocks, clauses of SPEC and comments behind code are left out.
pub(crate) fn stumbling_sentences(path: &Path, text: &str) -> Vec<Finding> {
    let is_markdown = path.extension().is_some_and(|it| it == "md");
    let mut findings = Vec::new();
    for paragraph in paragraphs(text, is_markdown) {
        for sentence in sentences(&paragraph) {
            let line = sentence[0].line;
            let finding = |text| Finding {
                file: path.to_owned(),
                line,
                text,
            };
            findings.extend(wrong_with(sentence).map(finding));
        }
    }
    findings
}

/// The relative clauses of a Rust file's comments, or of a Markdown file, that begin with a preposition.
///
/// 'The order in which' is left out: no other words for it are shorter.
pub(crate) fn chained_relatives(path: &Path, text: &str) -> Vec<Finding> {
    let is_markdown = path.extension().is_some_and(|it| it == "md");
    let paragraphs = paragraphs(text, is_markdown);
    let is_chain = |words: &&[Word<'_>]| {
        let [before, preposition, which] = words else {
            return false;
        };
        which.bare() == "which"
            && PREPOSITIONS.contains(&preposition.bare().to_lowercase().as_str())
            && before.bare() != "order"
    };
    let finding = |words: &[Word<'_>]| Finding {
        file: path.to_owned(),
        line: words[1].line,
        text: format!("'{} which'", words[1].bare()),
    };
    let chains = paragraphs
        .iter()
        .flat_map(|it| it.windows(3).filter(is_chain));
    chains.map(finding).collect()
}

/// The folder of the package that a file belongs to; `.` for a file of no package.
pub(crate) fn package_of(path: &Path, is_package: impl Fn(&Path) -> bool) -> &Path {
    let mut folders = path.ancestors().skip(1);
    let package = folders.find(|it| !it.as_os_str().is_empty() && is_package(it));
    package.unwrap_or(Path::new("."))
}

#[derive(Debug, Clone, Copy)]
struct Word<'a> {
    /// The first line is 1.
    line: usize,
    text: &'a str,
}

impl<'a> Word<'a> {
    /// The word without punctuation around it.
    fn bare(self) -> &'a str {
        self.text.trim_matches(|it: char| !it.is_alphanumeric())
    }

    /// Whether a sentence ends before `next`: behind a full stop that no lower-case letter follows,
    /// and behind each colon and semicolon.
    fn ends_before(self, next: Self) -> bool {
        let text = self.text.trim_end_matches(['"', '\'', ')', '*', '_', '`']);
        text.ends_with([':', ';'])
            || text.ends_with(['.', '!', '?']) && !next.text.starts_with(char::is_lowercase)
    }
}

/// Why a sentence is hard to read, if it is.
fn wrong_with(sentence: &[Word<'_>]) -> Option<String> {
    let count = sentence.iter().filter(|it| !it.bare().is_empty()).count();
    if count > WORDS_MAX {
        return Some(format!(
            "a sentence of {count} words: split it ({WORDS_MAX} at most)"
        ));
    }
    let quote = |words: &[&str], advice| format!("'{}': {advice}", words.join(" "));
    let is_question = sentence.last().is_some_and(|it| it.text.ends_with('?'));
    let begins = |words: &[&str]| {
        words.len() <= sentence.len() && words.iter().zip(sentence).all(|(a, b)| *a == b.bare())
    };
    let mut beginnings = BEGINNINGS.iter();
    if !is_question && let Some((words, advice)) = beginnings.find(|it| begins(it.0)) {
        return Some(quote(words, advice));
    }
    let contains = |words: &[&str]| {
        sentence.windows(words.len()).any(|window| {
            let mut pairs = words.iter().zip(window);
            pairs.all(|(a, b)| a.eq_ignore_ascii_case(b.bare()))
        })
    };
    let (words, advice) = PHRASES.iter().find(|it| contains(it.0))?;
    Some(quote(words, advice))
}

/// Splits a paragraph into sentences, and these at colons and semicolons.
fn sentences<'p, 'a>(paragraph: &'p [Word<'a>]) -> impl Iterator<Item = &'p [Word<'a>]> {
    let mut rest = paragraph;
    std::iter::from_fn(move || {
        let is_end = |pair: &[Word<'_>]| pair[0].ends_before(pair[1]);
        let len = rest
            .windows(2)
            .position(is_end)
            .map_or(rest.len(), |at| at + 1);
        let (sentence, after) = rest.split_at(len);
        rest = after;
        (!sentence.is_empty()).then_some(sentence)
    })
}

/// The words of each paragraph or item of a list.
fn paragraphs(text: &str, is_markdown: bool) -> Vec<Vec<Word<'_>>> {
    let mut paragraphs = vec![Vec::new()];
    let mut is_code = false;
    for (line, number) in text.lines().zip(1..) {
        let prose = if is_markdown {
            line.trim()
        } else {
            comment(line).unwrap_or("")
        };
        if prose.starts_with("```") {
            is_code = !is_code;
        }
        let is_clause = prose.starts_with("**SM2-") || prose.starts_with("~~SM2-");
        let is_other = ["|", "#", "<", "!", "```"]
            .iter()
            .any(|it| prose.starts_with(it));
        // A block that is indented by four columns, behind an empty line.
        let is_indented = is_markdown && line.starts_with("    ");
        let is_block = is_indented && paragraphs.last().is_some_and(Vec::is_empty);
        if prose.is_empty() || is_code || is_block || is_clause || is_other {
            paragraphs.push(Vec::new());
            continue;
        }
        let marker = prose.split_whitespace().next().unwrap_or("");
        let is_numbered = marker
            .strip_suffix('.')
            .is_some_and(|it| it.parse::<u8>().is_ok());
        let is_item = ["-", "*"].contains(&marker) || is_numbered;
        if is_item {
            paragraphs.push(Vec::new());
        }
        let words = prose.split_whitespace().skip(usize::from(is_item));
        let words = words.map(|text| Word { line: number, text });
        paragraphs.last_mut().expect("there is one").extend(words);
    }
    paragraphs
}

/// The text of a line that is a comment and nothing else; citations of clauses are none.
fn comment(line: &str) -> Option<&str> {
    let rest = line.trim().strip_prefix("//")?;
    if rest.starts_with('=') {
        return None;
    }
    Some(rest.trim_start_matches(['/', '!']).trim())
}
