//! A test of the repository itself: dependencies between files, sizes, types, repetition, sentences, time limits of
//! tests, causes of errors.
//!
//! Each check returns findings; `known.rs` lists the offenders that still exist. A list can only
//! shrink: a finding that is not listed fails, and so does an entry that finds nothing any more.
//! A check of Rust files by themselves is one more function in [`FILE_CHECKS`], one of Markdown files
//! in [`DOCUMENT_CHECKS`]; a banned phrase is one more line in `prose.rs`.

mod causes;
mod contract;
mod cycles;
mod edges;
mod known;
mod limits;
mod made_up;
mod made_up_limits;
mod modules;
mod packages;
mod prose;
mod repetition;
mod sizes;
mod sources;
mod types;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use sources::{Finding, Sources};

/// A check of one file by itself.
type FileCheck = fn(&Path, &str) -> Vec<Finding>;

/// Checks of Rust files.
const FILE_CHECKS: &[FileCheck] = &[sizes::long_file, sizes::long_functions, sizes::long_lines];
/// Checks of Markdown files.
const DOCUMENT_CHECKS: &[FileCheck] = &[sizes::long_document, sizes::long_markdown_lines];

fn root() -> &'static Path {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent();
    root.expect("the repository's root")
}

fn repository() -> Sources {
    Sources::read(root())
}

/// Offences by the path of a file, or of a crate's root: how many, and what to print of them.
type Offences = BTreeMap<PathBuf, (usize, String)>;

fn note(offences: &mut Offences, path: &Path, count: usize, text: &str) {
    let entry = offences.entry(path.to_owned()).or_default();
    entry.0 += count;
    entry.1 += text;
    entry.1.push('\n');
}

/// Fails if a path has more offences than its entry in the list of known ones, or if an entry has
/// none left. `advice` says how to mend one.
fn compare(mut offences: Offences, known: &[(&str, usize)], advice: &str) {
    for (_, text) in offences.values() {
        println!("{text}");
    }
    let mut wrong = String::new();
    for &(path, most) in known {
        match offences.remove(Path::new(path)) {
            Some((count, text)) if count > most => {
                wrong += &format!("{text}{path}: {count}, {most} before\n\n");
            }
            Some(_) => {}
            None => wrong += &format!("{path}: mended; remove its entry from tidy/known.rs\n\n"),
        }
    }
    for (path, (count, text)) in offences {
        wrong += &format!("{text}{}: {count}, none before\n\n", path.display());
    }
    assert!(wrong.is_empty(), "\n{wrong}{advice}");
}

#[test]
fn files_are_within_their_sizes() {
    let repository = repository();
    let rust = repository.rust().map(|file| (file, FILE_CHECKS));
    let documents = repository.markdown().map(|file| (file, DOCUMENT_CHECKS));
    let files: Vec<_> = rust.chain(documents).collect();
    assert!(files.len() > 500, "only {} files were found", files.len());
    let mut offences = Offences::new();
    for ((path, text), checks) in files {
        for finding in checks.iter().flat_map(|it| it(path, text)) {
            note(&mut offences, path, 1, &finding.to_string());
        }
    }
    let advice = "CONTRIBUTING, Style, has the sizes.";
    compare(offences, known::SIZES, advice);
}

#[test]
fn no_files_of_a_crate_depend_on_each_other() {
    let repository = repository();
    let roots = repository.crate_roots();
    assert!(roots.len() > 15, "only {} crates were found", roots.len());
    let mut offences = Offences::new();
    for root in roots {
        let edges = edges::edges(&modules::read_crate(&repository, root));
        for knot in cycles::knots(&edges) {
            note(&mut offences, root, knot.files.len(), &knot.to_string());
        }
    }
    let advice = "Dependencies go from roots to leaves: move what both files need into a file below \
                  both, or hand it over as an argument.";
    compare(offences, known::FILES_IN_CYCLES, advice);
}

#[test]
fn structures_have_few_flags() {
    let repository = repository();
    let files = repository.rust();
    let found = files.flat_map(|(path, text)| {
        let of_file = types::many_flags(path, text).into_iter();
        of_file.map(move |it| (path, it))
    });
    compare_types(&repository, found, known::FLAGS);
}

#[test]
fn a_type_is_implemented_in_few_files() {
    let repository = repository();
    let found = repository.crate_roots().into_iter().flat_map(|root| {
        let modules = modules::read_crate(&repository, root);
        let of_crate = types::scattered_types(&modules).into_iter();
        of_crate.map(move |it| (root, it))
    });
    compare_types(&repository, found, known::IMPL_FILES);
}

/// As [`compare`], for types. Each is found in a file or in the crate of a root file.
fn compare_types<'a>(
    repository: &Sources,
    found: impl Iterator<Item = (&'a Path, types::Misshapen)>,
    known: &[(&str, usize)],
) {
    let is_package = |folder: &Path| repository.get(&folder.join("Cargo.toml")).is_some();
    let mut offences = Offences::new();
    for (path, it) in found {
        let name = prose::package_of(path, is_package).join(&it.name);
        note(&mut offences, &name, it.count, &it.text);
    }
    let advice =
        "Make an enum or a structure of what belongs together; CONTRIBUTING, Style, has the rules.";
    compare(offences, known, advice);
}

#[test]
fn the_contract_of_a_link_lists_what_changes_it() {
    let sources = repository();
    let folder = Path::new("sm2-proto/src/link");
    let page = (sources.get(&folder.join("mod.rs"))).expect("the page of the link machine");
    let files = sources.rust().filter(|it| it.0.starts_with(folder));
    let changing = files.flat_map(|(path, text)| contract::changing(path, text));
    let changing: BTreeSet<_> = changing.collect();
    assert_eq!(contract::listed(page), changing);
}

#[test]
fn published_packages_describe_themselves() {
    let packages = packages::packages(root());
    let published = packages.iter().filter(|it| packages::is_published(it));
    let mut count = 0;
    let mut wrong = String::new();
    for package in published {
        count += 1;
        for missing in packages::missing(package, &|path| path.is_file()) {
            wrong += &format!("{}: lacks {missing}\n", package["name"]);
        }
    }
    assert!(count > 4, "only {count} published packages were found");
    assert!(
        wrong.is_empty(),
        "\n{wrong}Complete it, or set publish = false."
    );
}

#[test]
fn sentences_name_their_subjects() {
    let repository = repository();
    let is_package = |folder: &Path| repository.get(&folder.join("Cargo.toml")).is_some();
    let mut offences = Offences::new();
    for (path, text) in repository.rust().chain(repository.markdown()) {
        let package = prose::package_of(path, is_package);
        for finding in prose::stumbling_sentences(path, text) {
            note(&mut offences, package, 1, &finding.to_string());
        }
    }
    let advice = "CONTRIBUTING, Style, has the rules of sentences.";
    compare(offences, known::SENTENCES, advice);
}

#[test]
fn few_relative_clauses_begin_with_a_preposition() {
    let repository = repository();
    let files = repository.rust().chain(repository.markdown());
    let found: Vec<_> = files
        .flat_map(|(path, text)| prose::chained_relatives(path, text))
        .map(|it| it.to_string())
        .collect();
    let (count, most) = (found.len(), known::CHAINED_RELATIVES);
    println!("{}", found.join("\n"));
    assert!(
        count <= most,
        "{count} clauses begin as 'of which' does, {most} at most: split the sentence, or write \
         'whose', 'where' or 'that it has … for'"
    );
    assert!(
        count + 10 >= most,
        "only {count}: lower the limit of {most}"
    );
}

#[test]
fn no_test_depends_on_the_speed_of_the_machine() {
    let repository = repository();
    let mut offences = Offences::new();
    for (path, source) in repository.rust() {
        for finding in limits::hasty_tests(path, source) {
            note(&mut offences, path, 1, &finding.to_string());
        }
    }
    let advice = "CONTRIBUTING, Tests that load cannot break, has the rules.";
    compare(offences, known::HASTY_TESTS, advice);
}

#[test]
fn no_error_shows_its_own_source() {
    let repository = repository();
    let rust = repository.rust();
    let found: Vec<_> = rust
        .flat_map(|(path, it)| causes::shown_sources(path, it))
        .collect();
    let lines: String = found.iter().map(|it| format!("{it}\n")).collect();
    let advice = "Programs that print the chain of an error would print that cause twice. Name the field `r#source`, \
                  or leave out #[source] and #[from]; the head of sm2-node/src/error.rs has the reason.";
    assert!(found.is_empty(), "\n{lines}{advice}");
}

#[test]
fn nothing_is_written_twice() {
    let repository = repository();
    let mut offences = Offences::new();
    for it in repetition::repetitions(repository.rust()) {
        let (file, first) = (it.file.display(), it.first.0.display());
        let (line, first_line, count) = (it.line, it.first.1, it.count);
        let text = format!("{file}:{line}: {count} lines as at {first}:{first_line}");
        note(&mut offences, &it.file, 1, &text);
    }
    let advice = "Let one piece of code serve both places.";
    compare(offences, known::REPETITIONS, advice);
}
