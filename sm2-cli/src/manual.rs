//! `sm2 man`: manual pages from the texts of `--help`.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use clap::{Args, Command};
use clap_mangen::Man;
use roff::{Roff, bold, roman};

use crate::{ended::Ended, error::CliError, output::Output};

/// `sm2 man`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The command whose page is printed [default: sm2 itself]
    #[arg(value_name = "COMMAND", conflicts_with = "dir")]
    command: Vec<String>,
    /// Write the pages of all commands into this folder: sm2.1, sm2-topic.1, ...
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
}

const HELP: &str = "\
Examples:
  sm2 man | man -l -
  sm2 man topic hz | man -l -
  sm2 man --dir /usr/local/share/man/man1";

/// Prints the page of a command of `root`, or writes the pages of all.
///
/// # Errors
///
/// [`CliError::Output`], [`CliError::File`], [`CliError::NoSuchCommand`].
pub(crate) fn run(arguments: &Arguments, mut root: Command) -> Result<Ended, CliError> {
    // Gives every command its whole name: `sm2 topic hz`.
    root.build();
    match &arguments.dir {
        Some(dir) => {
            let failed = |source| CliError::file("create folder", dir, source);
            fs::create_dir_all(dir).map_err(failed)?;
            write_pages(&root, dir)?;
        }
        None => {
            let page = page(named(&root, &arguments.command)?).map_err(CliError::Output)?;
            let mut out = Output::new();
            out.write(|out| out.write_all(&page))?;
        }
    }
    Ok(Ended::Done)
}

fn named<'a>(root: &'a Command, words: &[String]) -> Result<&'a Command, CliError> {
    words.iter().try_fold(root, |command, word| {
        let found = visible(command).find(|it| it.get_name() == word);
        found.ok_or_else(|| CliError::NoSuchCommand {
            command: words.join(" "),
        })
    })
}

/// The subcommands of a command, without hidden ones and without `help`, which has no page.
fn visible(command: &Command) -> impl Iterator<Item = &Command> {
    command
        .get_subcommands()
        .filter(|it| !it.is_hide_set() && it.get_name() != "help")
}

fn write_pages(command: &Command, dir: &Path) -> Result<(), CliError> {
    let path = dir.join(format!("{}.1", full_name(command)));
    let written = page(command).and_then(|page| fs::write(&path, page));
    written.map_err(|source| CliError::file("write", &path, source))?;
    visible(command).try_for_each(|it| write_pages(it, dir))
}

/// `sm2-topic-hz`.
fn full_name(command: &Command) -> String {
    let name = command.get_bin_name().unwrap_or(command.get_name());
    name.replace(' ', "-")
}

/// The page of a command: clap's sections, and the paragraphs after the help as further sections.
fn page(command: &Command) -> io::Result<Vec<u8>> {
    // Otherwise the page would list `help`, which has no page.
    let command = command.clone().disable_help_subcommand(true);
    let name = full_name(&command);
    let man = Man::new(command.clone())
        .title(&name)
        .source(concat!("sm2 ", env!("CARGO_PKG_VERSION")))
        .manual("SM2");
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    man.render_options_section(&mut page)?;
    let mut rest = Roff::new();
    if visible(&command).next().is_some() {
        rest.control("SH", ["COMMANDS"]);
        for it in visible(&command) {
            let about = it.get_about().map(ToString::to_string).unwrap_or_default();
            rest.control("TP", []);
            rest.text([bold(full_name(it)), roman("(1)")]);
            rest.text([roman(about)]);
        }
    }
    let after = command.get_after_help().map(ToString::to_string);
    let mut section = "";
    for paragraph in after.unwrap_or_default().split("\n\n") {
        section = add_paragraph(&mut rest, paragraph, section);
    }
    rest.to_writer(&mut page)?;
    Ok(page)
}

/// Adds a paragraph of help below those of `section`, and returns the section that the paragraph belongs to.
/// A paragraph that starts with a known heading, such as `Examples:`, begins that section.
fn add_paragraph(page: &mut Roff, paragraph: &str, section: &'static str) -> &'static str {
    const HEADINGS: [(&str, &str); 4] = [
        ("Exit status:", "EXIT STATUS"),
        ("Environment:", "ENVIRONMENT"),
        ("Format:", "FORMAT"),
        ("Examples:", "EXAMPLES"),
    ];
    let known = HEADINGS
        .iter()
        .find_map(|(start, heading)| Some((*heading, paragraph.strip_prefix(start)?)));
    let (heading, text) = known.unwrap_or(("NOTES", paragraph));
    let text = text.trim_matches('\n');
    if text.is_empty() {
        return section;
    }
    match heading == section {
        true => page.control("PP", []),
        false => page.control("SH", heading.split(' ')),
    };
    match heading {
        // Keeps the line breaks and the indentation.
        "EXAMPLES" | "FORMAT" => page.control("nf", []).text([roman(text)]).control("fi", []),
        _ => page.text([roman(text.trim_start())]),
    };
    heading
}
