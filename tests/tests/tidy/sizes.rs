//! Sizes of files, functions, lines and documents.

use std::path::Path;

use syn::{
    Block, ImplItemFn, ItemFn, Signature, TraitItemFn,
    spanned::Spanned,
    visit::{self, Visit},
};

use super::sources::Finding;

const FILE_LINES_MAX: usize = 500;
const FUNCTION_LINES_MAX: usize = 70;
const COLUMNS_MAX: usize = 120;

/// Documents that stay short, and their greatest sizes in bytes.
const DOCUMENTS: &[(&str, usize)] = &[
    ("ARCHITECTURE.md", 14_500),
    ("CHANGELOG.md", 4_000),
    ("CONTRIBUTING.md", 14_000),
    ("README.md", 15_200),
    ("SECURITY.md", 19_400),
    ("SPEC.md", 175_000),
    ("bench/README.md", 24_400),
    ("bridges/README.md", 13_200),
    ("docs/src/gateways.md", 9_700),
    ("docs/src/qos.md", 9_800),
    ("docs/src/recording.md", 16_400),
    ("verification/PROPERTIES.md", 23_500),
    ("verification/README.md", 18_500),
];
/// Lines of Markdown that begin so can be longer: rows of tables, and clauses of SPEC.
const LONG_LINES: &[&str] = &["|", "**SM2-", "~~SM2-"];

/// A file of too many lines.
pub(crate) fn long_file(path: &Path, text: &str) -> Vec<Finding> {
    let lines = text.lines().count();
    let finding = |text| Finding {
        file: path.to_owned(),
        line: lines,
        text,
    };
    (lines > FILE_LINES_MAX)
        .then(|| {
            finding(format!(
                "{lines} lines: split it ({FILE_LINES_MAX} at most)"
            ))
        })
        .into_iter()
        .collect()
}

/// Lines of too many columns.
pub(crate) fn long_lines(path: &Path, text: &str) -> Vec<Finding> {
    let columns = text.lines().map(|it| it.chars().count()).zip(1..);
    let long = columns.filter(|it| it.0 > COLUMNS_MAX);
    let finding = |(columns, line)| Finding {
        file: path.to_owned(),
        line,
        text: format!("{columns} columns: wrap it ({COLUMNS_MAX} at most)"),
    };
    long.map(finding).collect()
}

/// Lines of a Markdown file with too many columns, except for code blocks and [`LONG_LINES`].
pub(crate) fn long_markdown_lines(path: &Path, text: &str) -> Vec<Finding> {
    let mut is_code = false;
    let wrapped = text.lines().map(|line| {
        let start = line.trim_start();
        let is_fence = start.starts_with("```");
        is_code ^= is_fence;
        let is_free = is_code || is_fence || LONG_LINES.iter().any(|it| start.starts_with(it));
        if is_free { "" } else { line }
    });
    let wrapped: Vec<_> = wrapped.collect();
    long_lines(path, &wrapped.join("\n"))
}

/// A document that is longer than it may be.
pub(crate) fn long_document(path: &Path, text: &str) -> Vec<Finding> {
    let is_longer = |it: &&(&str, usize)| path == Path::new(it.0) && text.len() > it.1;
    let longer = DOCUMENTS.iter().filter(is_longer);
    let finding = |&(_, most): &(&str, usize)| Finding {
        file: path.to_owned(),
        line: text.lines().count(),
        text: format!("{} bytes: shorten it ({most} at most)", text.len()),
    };
    longer.map(finding).collect()
}

/// Functions of too many lines, from `fn` to the closing brace.
pub(crate) fn long_functions(path: &Path, text: &str) -> Vec<Finding> {
    if !may_be_long(text) {
        return Vec::new();
    }
    let parsed = syn::parse_file(text);
    let parsed = parsed.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut visitor = Functions {
        path,
        findings: Vec::new(),
    };
    visitor.visit_file(&parsed);
    visitor.findings
}

/// Whether a function may have too many lines, judged by indentation, as rustfmt leaves it. Parsing takes long.
fn may_be_long(text: &str) -> bool {
    let lines: Vec<&str> = text.lines().collect();
    let indent = |line: &str| line.len() - line.trim_start().len();
    let mut numbered = lines.iter().enumerate();
    numbered.any(|(first, line)| {
        let ends = |it: &&str| it.trim_start().starts_with('}') && indent(it) <= indent(line);
        line.contains("fn ") && !lines[first..].iter().take(FUNCTION_LINES_MAX).any(ends)
    })
}

struct Functions<'a> {
    path: &'a Path,
    findings: Vec<Finding>,
}

impl Functions<'_> {
    fn measure(&mut self, signature: &Signature, body: &Block) {
        let line = signature.span().start().line;
        let lines = body.span().end().line + 1 - line;
        if lines > FUNCTION_LINES_MAX {
            let name = &signature.ident;
            let text = format!("{name} has {lines} lines: split it ({FUNCTION_LINES_MAX} at most)");
            self.findings.push(Finding {
                file: self.path.to_owned(),
                line,
                text,
            });
        }
    }
}

impl<'ast> Visit<'ast> for Functions<'_> {
    fn visit_item_fn(&mut self, it: &'ast ItemFn) {
        self.measure(&it.sig, &it.block);
        visit::visit_item_fn(self, it);
    }

    fn visit_impl_item_fn(&mut self, it: &'ast ImplItemFn) {
        self.measure(&it.sig, &it.block);
        visit::visit_impl_item_fn(self, it);
    }

    fn visit_trait_item_fn(&mut self, it: &'ast TraitItemFn) {
        if let Some(body) = &it.default {
            self.measure(&it.sig, body);
        }
        visit::visit_trait_item_fn(self, it);
    }
}
