//! Tests of the documents: links have targets, the book contains all its pages, and its programs
//! are compiled.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};
use std::{fs, io};

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

/// Addresses in the book that stand for files of this repository.
const FILES_ONLINE: &str = "https://github.com/sm2-robotics/sm2/blob/main/";
/// Folders that are not part of the documents.
const SKIPPED: [&str; 3] = ["target", "node_modules", "book"];

#[test]
fn links_lead_to_files_and_headings() {
    let documents = documents().expect("the repository can be read");
    let mut checked = 0;
    let mut broken = Vec::new();
    for (path, document) in &documents {
        for link in &document.links {
            let Some((file, anchor)) = target(path, link) else {
                continue;
            };
            checked += 1;
            let found = match (documents.get(&file), anchor) {
                (Some(to), Some(anchor)) => to.anchors.contains(anchor),
                (None, Some(_)) => false,
                (_, None) => root().join(&file).exists(),
            };
            if !found {
                broken.push(format!("{}: {link}", path.display()));
            }
        }
    }
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
    assert!(checked > 100, "only {checked} links were found");
}

#[test]
fn the_summary_names_all_pages_of_the_book() {
    let documents = documents().expect("the repository can be read");
    let book = Path::new("docs/src");
    let summary = book.join("SUMMARY.md");
    let pages: BTreeSet<&PathBuf> = documents
        .keys()
        .filter(|path| path.starts_with(book) && **path != summary)
        .collect();
    let named: BTreeSet<PathBuf> = documents[&summary]
        .links
        .iter()
        .filter_map(|link| target(&summary, link))
        .map(|(file, _)| file)
        .collect();
    assert_eq!(pages, named.iter().collect());
}

#[test]
fn programs_in_documents_are_compiled() {
    let compiled = fs::read_to_string(root().join("tests/src/documents.rs")).expect("a file");
    let documents = documents().expect("the repository can be read");
    let read = documents
        .iter()
        .filter(|(path, _)| path.starts_with("docs") || **path == Path::new("README.md"));
    for (path, document) in read {
        for block in &document.rust {
            if let Some(include) = block.text.trim().strip_prefix("{{#include ") {
                // An example of a crate, or the package `sm2-ros/example`: `cargo test` compiles them.
                let example = include.trim_end_matches("}}");
                let file = plain(&path.parent().expect("a folder").join(example));
                assert!(
                    root().join(&file).is_file(),
                    "{}: {example}",
                    path.display()
                );
                let is_example = |it: &std::ffi::OsStr| it == "examples" || it == "example";
                assert!(file.iter().any(is_example), "{}", file.display());
                continue;
            }
            let name = format!("../../{}\"", path.display());
            assert!(
                compiled.contains(&name),
                "{}: add it to tests/src/documents.rs, so that its code is compiled",
                path.display()
            );
            assert!(
                !block.info.contains("ignore"),
                "{}: a block is not compiled:\n{}",
                path.display(),
                block.text
            );
        }
    }
}

#[test]
fn a_heading_becomes_an_anchor_as_on_github() {
    let document = Document::parse("# `sm2 top`: rates, live\n## A b\n## A b\n");
    let anchors = ["sm2-top-rates-live", "a-b", "a-b-1"].map(String::from);
    assert_eq!(document.anchors, BTreeSet::from(anchors));
}

#[test]
fn a_broken_link_is_found() {
    let from = Path::new("docs/src/faq.md");
    let expected = (PathBuf::from("SPEC.md"), Some("names"));
    assert_eq!(target(from, "../../SPEC.md#names"), Some(expected));
    let online = format!("{FILES_ONLINE}SPEC.md");
    assert_eq!(
        target(from, &online),
        Some((PathBuf::from("SPEC.md"), None))
    );
    assert_eq!(target(from, "https://quinn-rs.github.io"), None);
    let documents = documents().expect("the repository can be read");
    assert!(!documents.contains_key(Path::new("docs/src/nothing.md")));
    assert!(!documents[Path::new("SPEC.md")].anchors.contains("nothing"));
}

/// The parts of a Markdown file that the tests use.
#[derive(Default)]
struct Document {
    links: Vec<String>,
    anchors: BTreeSet<String>,
    rust: Vec<Block>,
}

/// A block of code, with the text after its fence.
struct Block {
    info: String,
    text: String,
}

impl Document {
    fn parse(text: &str) -> Self {
        let mut document = Self::default();
        let mut seen = BTreeMap::<String, usize>::new();
        let mut heading: Option<String> = None;
        let mut block: Option<Block> = None;
        for event in Parser::new_ext(text, Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH) {
            match event {
                Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                    document.links.push(dest_url.into_string());
                }
                Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
                Event::End(TagEnd::Heading(_)) => {
                    let slug = slug(&heading.take().expect("a heading began"));
                    let count = seen.entry(slug.clone()).or_default();
                    document.anchors.insert(match *count {
                        0 => slug,
                        count => format!("{slug}-{count}"),
                    });
                    *count += 1;
                }
                Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(info)))
                    if info.starts_with("rust") =>
                {
                    let info = info.into_string();
                    block = Some(Block {
                        info,
                        text: String::new(),
                    });
                }
                Event::End(TagEnd::CodeBlock) => document.rust.extend(block.take()),
                Event::Text(text) | Event::Code(text) => {
                    let texts = [heading.as_mut(), block.as_mut().map(|it| &mut it.text)];
                    texts
                        .into_iter()
                        .flatten()
                        .for_each(|it| it.push_str(&text));
                }
                _ => {}
            }
        }
        document
    }
}

/// The anchor that GitHub gives a heading.
fn slug(heading: &str) -> String {
    let kept = heading
        .chars()
        .filter(|it| it.is_alphanumeric() || matches!(it, ' ' | '-' | '_'));
    kept.flat_map(char::to_lowercase)
        .map(|it| if it == ' ' { '-' } else { it })
        .collect()
}

/// The file in the repository and the anchor that a link in `from` leads to; `None` for other
/// targets.
fn target<'a>(from: &Path, link: &'a str) -> Option<(PathBuf, Option<&'a str>)> {
    let (address, anchor) = match link.split_once('#') {
        Some((address, anchor)) => (address, Some(anchor)),
        None => (link, None),
    };
    if let Some(path) = address.strip_prefix(FILES_ONLINE) {
        return Some((PathBuf::from(path), anchor));
    }
    if address.contains("://") || address.starts_with("mailto:") {
        return None;
    }
    let folder = from.parent().expect("a file has a folder");
    let file = if address.is_empty() {
        from.to_owned()
    } else {
        plain(&folder.join(address))
    };
    Some((file, anchor))
}

/// The path with `..` resolved.
fn plain(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut plain, part| {
        match part {
            Component::ParentDir => {
                plain.pop();
            }
            Component::CurDir => {}
            part => plain.push(part),
        }
        plain
    })
}

/// All Markdown files of the repository, by their paths from its root.
fn documents() -> io::Result<BTreeMap<PathBuf, Document>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root().join(&folder))? {
            let entry = entry?;
            let name = entry.file_name();
            let path = folder.join(&name);
            let hidden = name.to_string_lossy().starts_with('.');
            if entry.file_type()?.is_dir() {
                if !hidden && !SKIPPED.iter().any(|it| name == *it) {
                    folders.push(path);
                }
            } else if path.extension().is_some_and(|it| it == "md") {
                let text = fs::read_to_string(entry.path())?;
                found.insert(path, Document::parse(&text));
            }
        }
    }
    Ok(found)
}

fn root() -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests.parent().expect("the root is above").to_owned()
}
