//! The command reference of the book, generated from clap: the file `docs/generated/commands.txt`, which the page
//! `docs/src/commands.md` includes, and which is not committed.
//!
//! `SM2_WRITE_REFERENCE=1 cargo test -p sm2-cli --lib reference` writes it.

use std::{collections::BTreeMap, env, fmt::Write as _, fs, path::Path};

use clap::{Arg, Command, CommandFactory as _};
use sm2_manager::program::LimitArguments;

use crate::command::Cli;

/// An option that has the same row in this number of commands is explained once.
const MANY: usize = 30;

const MANY_TITLE: &str = "## Common options\n";

const MANY_LINK: &str = "[common options](#common-options)";

const ARGUMENTS_HEAD: &str = "\n| argument | meaning |\n| --- | --- |\n";

/// The row of the options for all limits of a Manager.
const LIMITS_ROW: &str =
    "| `--LIMIT <VALUE>` | A limit, by its name with dashes: see [Limits](limits.md) |\n";

#[test]
fn the_reference_has_the_commands_of_clap() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let mut root = Cli::command();
    // Gives every command its whole name: `sm2 topic hz`.
    root.build();
    let commands = reference(&root);
    for command in ["sm2", "sm2 topic", "sm2 topic hz", "sm2 gateway keygen"] {
        assert!(commands.contains(&format!("\n## {command}\n")), "{command}");
    }
    if env::var_os("SM2_WRITE_REFERENCE").is_some() {
        let generated = docs.join("generated");
        fs::create_dir_all(&generated).unwrap();
        fs::write(generated.join("commands.txt"), commands).unwrap();
    }
    let page = fs::read_to_string(docs.join("src/commands.md")).unwrap();
    assert!(
        page.contains("{{#include ../generated/commands.txt}}"),
        "{page}"
    );
}

#[test]
fn remarks_of_examples_become_comments() {
    assert_eq!(
        example("  sm2 doctor   find problems"),
        "sm2 doctor  # find problems"
    );
    assert_eq!(example("  sm2 top"), "sm2 top");
}

#[test]
fn table_cells_are_escaped() {
    assert_eq!(escaped("a|b <c> *d*\ne"), "a\\|b \\<c\\> \\*d\\* e");
    assert_eq!(escaped("`a_b|c` d_e"), "`a_b\\|c` d\\_e");
}

/// All commands.
fn reference(root: &Command) -> String {
    let mut counts = BTreeMap::new();
    count_arguments(&mut counts, root);
    counts.retain(|_, count| *count >= MANY);
    let mut page = MANY_TITLE.to_owned();
    page.push_str(ARGUMENTS_HEAD);
    page.extend(counts.keys().map(String::as_str));
    add_command(&mut page, root, &counts);
    page
}

/// Counts the commands that have the same row.
fn count_arguments(counts: &mut BTreeMap<String, usize>, command: &Command) {
    for argument in arguments(command) {
        *counts.entry(row(argument)).or_default() += 1;
    }
    for child in children(command) {
        count_arguments(counts, child);
    }
}

/// The commands of a command that its help lists.
fn children(command: &Command) -> impl Iterator<Item = &Command> {
    let all = command.get_subcommands();
    all.filter(|it| !it.is_hide_set() && it.get_name() != "help")
}

/// The arguments that the help of a command lists, but for `--help` and `--version`.
fn arguments(command: &Command) -> impl Iterator<Item = &Arg> {
    command.get_arguments().filter(|it| {
        !it.is_hide_set() && !matches!(it.get_id().as_str(), "help" | "version" | "subcommand")
    })
}

/// Appends a command and its commands, depth first. The rows of `shared` are left out.
fn add_command(page: &mut String, command: &Command, shared: &BTreeMap<String, usize>) {
    let name = command.get_bin_name().unwrap_or(command.get_name());
    let about = command.get_about().map(ToString::to_string);
    let mut usage = command.clone();
    let usage = usage.render_usage().to_string();
    let usage = usage.trim_start_matches("Usage: ");
    // `write!` to a string cannot fail.
    let _ = write!(
        page,
        "\n## {name}\n\n{}.\n",
        escaped(&about.unwrap_or_default())
    );
    let _ = write!(page, "\n```text\n{usage}\n```\n");
    if children(command).next().is_some() {
        page.push_str("\n| command | what it does |\n| --- | --- |\n");
        for child in children(command) {
            let name = child.get_bin_name().unwrap_or(child.get_name());
            let anchor = name.replace(' ', "-");
            let about = child.get_about().map(ToString::to_string);
            let about = escaped(&about.unwrap_or_default());
            let _ = writeln!(page, "| [`{name}`](#{anchor}) | {about} |");
        }
    }
    add_arguments(page, command, shared);
    let after = command.get_after_help().map(ToString::to_string);
    for paragraph in after.unwrap_or_default().split("\n\n") {
        add_paragraph(page, paragraph);
    }
    for child in children(command) {
        add_command(page, child, shared);
    }
}

/// Appends a table of the arguments. Those of `shared` and the limits of a Manager are in tables of their own.
fn add_arguments(page: &mut String, command: &Command, shared: &BTreeMap<String, usize>) {
    let is_limit = |it: &&Arg| it.get_help_heading() == Some(LimitArguments::HEADING);
    let (limits, arguments): (Vec<_>, Vec<_>) = arguments(command).partition(is_limit);
    let rows = arguments.into_iter().map(row);
    let (common, own): (Vec<_>, Vec<_>) = rows.partition(|it| shared.contains_key(it));
    if !own.is_empty() || !limits.is_empty() {
        page.push_str(ARGUMENTS_HEAD);
    }
    page.extend(own);
    if !limits.is_empty() {
        page.push_str(LIMITS_ROW);
    }
    if !common.is_empty() {
        assert_eq!(common.len(), shared.len(), "{command}: some of them only");
        let _ = write!(page, "\nAlso the {MANY_LINK}.\n");
    }
}

/// The row of an argument.
fn row(argument: &Arg) -> String {
    let mut meaning = argument.get_help().map(ToString::to_string);
    let text = meaning.get_or_insert_default();
    let takes_value = argument.get_action().takes_values();
    let defaults: Vec<_> = argument.get_default_values().iter().collect();
    if let ([default], true) = (&*defaults, takes_value) {
        let _ = write!(text, " [default: {}]", default.to_string_lossy());
    }
    let values = argument.get_possible_values();
    let values: Vec<_> = values.iter().map(|it| it.get_name()).collect();
    if takes_value && !values.is_empty() {
        let _ = write!(text, " [possible values: {}]", values.join(", "));
    }
    let name = argument.to_string().replace('|', "\\|");
    format!("| `{name}` | {} |\n", escaped(text))
}

/// Appends a paragraph of the text below the help. Indented lines keep their form.
fn add_paragraph(page: &mut String, paragraph: &str) {
    let paragraph = paragraph.trim_matches('\n');
    if let Some(examples) = paragraph.strip_prefix("Examples:\n") {
        let lines: Vec<_> = examples.lines().map(example).collect();
        let _ = write!(page, "\n```sh\n{}\n```\n", lines.join("\n"));
    } else if paragraph.lines().any(|line| line.starts_with("  ")) {
        let _ = write!(page, "\n```text\n{paragraph}\n```\n");
    } else if !paragraph.is_empty() {
        let _ = write!(page, "\n{}\n", escaped(paragraph));
    }
}

/// An example as a line of a shell script. Two blanks separate a remark.
fn example(line: &str) -> String {
    let line = line.trim_start();
    match line.split_once("  ") {
        Some((command, remark)) => format!("{command}  # {}", remark.trim_start()),
        None => line.to_owned(),
    }
}

/// A text on one line, with Markdown's special characters escaped outside of code.
fn escaped(text: &str) -> String {
    let mut escaped = String::new();
    let mut in_code = false;
    for c in text.chars() {
        in_code ^= c == '`';
        match c {
            '\n' => escaped.push(' '),
            // Ends a cell of a table even in code.
            '|' => escaped.push_str("\\|"),
            '<' | '>' | '*' | '[' | ']' | '_' if !in_code => escaped.extend(['\\', c]),
            c => escaped.push(c),
        }
    }
    escaped
}
