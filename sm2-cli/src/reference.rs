//! The command reference of the book, generated from clap: `docs/src/commands.md`.
//!
//! `SM2_WRITE_REFERENCE=1 cargo test -p sm2-cli --lib reference` writes the file.

use std::{env, fmt::Write as _, fs, path::Path};

use clap::{Arg, Command, CommandFactory as _};
use sm2_manager::program::LimitArguments;

use crate::command::Cli;

const INTRODUCTION: &str = "\
# Command reference

This chapter is the text of `sm2 help`, generated from the program. `sm2 man` prints the same as manual pages.
";

/// The row of the options for all limits of a Manager.
const LIMITS_ROW: &str =
    "| `--LIMIT <VALUE>` | A limit, by its name with dashes: see [Limits](limits.md) |\n";

#[test]
fn the_book_has_the_commands_of_clap() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/src/commands.md");
    let mut root = Cli::command();
    // Gives every command its whole name: `sm2 topic hz`.
    root.build();
    let mut expected = INTRODUCTION.to_owned();
    add_command(&mut expected, &root);
    if env::var_os("SM2_WRITE_REFERENCE").is_some() {
        fs::write(&path, &expected).unwrap();
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    let differs = found.lines().zip(expected.lines()).find(|(a, b)| a != b);
    assert!(
        found == expected,
        "docs/src/commands.md is out of date ({differs:?}): write it again with \
         SM2_WRITE_REFERENCE=1 cargo test -p sm2-cli --lib reference"
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

/// Appends a command and its commands, depth first.
fn add_command(page: &mut String, command: &Command) {
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
    let children: Vec<_> = command
        .get_subcommands()
        .filter(|it| !it.is_hide_set() && it.get_name() != "help")
        .collect();
    if !children.is_empty() {
        page.push_str("\n| command | what it does |\n| --- | --- |\n");
        for child in &children {
            let name = child.get_bin_name().unwrap_or(child.get_name());
            let anchor = name.replace(' ', "-");
            let about = child.get_about().map(ToString::to_string);
            let about = escaped(&about.unwrap_or_default());
            let _ = writeln!(page, "| [`{name}`](#{anchor}) | {about} |");
        }
    }
    add_arguments(page, command);
    let after = command.get_after_help().map(ToString::to_string);
    for paragraph in after.unwrap_or_default().split("\n\n") {
        add_paragraph(page, paragraph);
    }
    for child in children {
        add_command(page, child);
    }
}

/// Appends a table of the arguments, but for `--help` and `--version`. The limits of a Manager are in another table.
fn add_arguments(page: &mut String, command: &Command) {
    let is_listed = |it: &&Arg| {
        !it.is_hide_set() && !matches!(it.get_id().as_str(), "help" | "version" | "subcommand")
    };
    let arguments: Vec<_> = command.get_arguments().filter(is_listed).collect();
    if arguments.is_empty() {
        return;
    }
    page.push_str("\n| argument | meaning |\n| --- | --- |\n");
    let mut has_limits = false;
    for argument in arguments {
        if argument.get_help_heading() == Some(LimitArguments::HEADING) {
            has_limits = true;
            continue;
        }
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
        let _ = writeln!(page, "| `{name}` | {} |", escaped(text));
    }
    if has_limits {
        page.push_str(LIMITS_ROW);
    }
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
