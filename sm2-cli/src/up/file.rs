//! Reads `robot.toml`: TOML without unknown keys.

use std::{
    collections::BTreeMap,
    env, fmt, fs,
    ops::Range,
    path::{Path, PathBuf},
};

use nix::unistd::{AccessFlags, access};
use serde::{
    Deserialize, Deserializer,
    de::{SeqAccess, Visitor, value::SeqAccessDeserializer},
};
use sm2_node::params::{self, FILE_VARIABLE};
use toml::Spanned;

use super::{
    error::{Fault, UpError},
    limits::{RESTARTS, STOP_TIMEOUT},
    robot::{Program, RestartPolicy, Robot},
};
use crate::{time, wait_for::Expression};

/// The name of the Manager among the programs.
pub(super) const MANAGER: &str = "manager";

/// The longest name of a program.
const NAME_MAX: usize = 64;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    domain: Option<String>,
    #[serde(default = "yes")]
    manager: bool,
    stop_timeout: Option<Spanned<String>>,
    /// For each program without another one.
    params: Option<Spanned<PathBuf>>,
    #[serde(default)]
    program: BTreeMap<Spanned<String>, ProgramTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProgramTable {
    command: Spanned<Command>,
    directory: Option<Spanned<PathBuf>>,
    #[serde(default)]
    environment: BTreeMap<Spanned<String>, String>,
    params: Option<Spanned<PathBuf>>,
    #[serde(default)]
    restart: RestartPolicy,
    #[serde(default = "restarts")]
    max_restarts: u32,
    #[serde(default)]
    after: Vec<Spanned<String>>,
}

fn yes() -> bool {
    true
}

fn restarts() -> u32 {
    RESTARTS
}

/// The words of a command, or one text with all of them.
enum Command {
    Words(Vec<String>),
    Text(String),
}

impl<'de> Deserialize<'de> for Command {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;
        impl<'de> Visitor<'de> for Forms {
            type Value = Command;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a text such as \"lidar --fast\", or a list of words")
            }

            fn visit_str<E>(self, text: &str) -> Result<Command, E> {
                Ok(Command::Text(text.to_owned()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, words: A) -> Result<Command, A::Error> {
                Vec::deserialize(SeqAccessDeserializer::new(words)).map(Command::Words)
            }
        }
        deserializer.deserialize_any(Forms)
    }
}

/// Reads and checks a file. Relative paths in it are relative to its folder.
///
/// # Errors
///
/// [`UpError::Read`], [`UpError::Wrong`].
pub(super) fn load(path: &Path) -> Result<Robot, UpError> {
    let read = fs::read_to_string(path).and_then(|text| Ok((text, fs::canonicalize(path)?)));
    let (text, full) = read.map_err(|source| UpError::Read {
        path: path.to_owned(),
        source,
    })?;
    let source = Source {
        path,
        text: &text,
        folder: full.parent().unwrap_or(Path::new("/")),
    };
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    source.robot(name.into_owned())
}

/// The text of a file, with the places of its parts.
struct Source<'a> {
    path: &'a Path,
    text: &'a str,
    folder: &'a Path,
}

impl Source<'_> {
    fn wrong(&self, span: &Range<usize>, fault: Fault) -> UpError {
        let before = self.text.get(..span.start).unwrap_or("");
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        UpError::Wrong {
            path: self.path.to_owned(),
            line: before.matches('\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
            fault: Box::new(fault),
        }
    }

    fn robot(&self, name: String) -> Result<Robot, UpError> {
        let file: File = toml::from_str(self.text).map_err(|error| {
            let span = error.span().unwrap_or_default();
            self.wrong(&span, Fault::Toml(error.message().to_owned()))
        })?;
        if file.program.is_empty() {
            return Err(self.wrong(&(0..0), Fault::NoProgram));
        }
        let stop_timeout = match &file.stop_timeout {
            None => STOP_TIMEOUT,
            Some(text) => time::span(text.get_ref())
                .map_err(|reason| self.wrong(&text.span(), Fault::Time(reason)))?,
        };
        let mut tables: Vec<_> = file.program.iter().collect();
        tables.sort_by_key(|(name, _)| name.span().start);
        let programs = tables.into_iter().map(|(name, table)| {
            if file.manager && name.get_ref() == MANAGER {
                return Err(self.wrong(&name.span(), Fault::ManagerName));
            }
            self.program(name, table, file.params.as_ref())
        });
        Ok(Robot {
            name,
            domain: file.domain,
            has_manager: file.manager,
            stop_timeout,
            programs: programs.collect::<Result<_, _>>()?,
        })
    }

    fn program(
        &self,
        name: &Spanned<String>,
        table: &ProgramTable,
        shared_params: Option<&Spanned<PathBuf>>,
    ) -> Result<Program, UpError> {
        let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
        let text = name.get_ref();
        if !(1..=NAME_MAX).contains(&text.len()) || !text.chars().all(is_part) {
            return Err(self.wrong(&name.span(), Fault::Name));
        }
        let folder = match &table.directory {
            None => self.folder.to_owned(),
            Some(directory) => {
                let folder = self.folder.join(directory.get_ref());
                if !folder.is_dir() {
                    return Err(self.wrong(&directory.span(), Fault::NoDirectory(folder)));
                }
                folder
            }
        };
        let params = table.params.as_ref().or(shared_params);
        let environment = self.environment(table, params)?;
        let path = environment.iter().find(|(name, _)| name == "PATH");
        let path = path.map(|(_, value)| value.as_str());
        Ok(Program {
            name: text.clone(),
            command: self.command(&table.command, &folder, path)?,
            environment,
            folder,
            policy: table.restart,
            max_restarts: table.max_restarts,
            after: self.conditions(&table.after)?,
        })
    }

    fn command(
        &self,
        command: &Spanned<Command>,
        folder: &Path,
        path: Option<&str>,
    ) -> Result<Vec<String>, UpError> {
        let wrong = |fault| self.wrong(&command.span(), fault);
        let mut words = match command.get_ref() {
            Command::Words(words) => words.clone(),
            Command::Text(text) => shlex::split(text).ok_or_else(|| wrong(Fault::OpenQuote))?,
        };
        if words.iter().any(|word| word.contains('\0')) {
            return Err(wrong(Fault::Zero));
        }
        let program = words.first().filter(|word| !word.is_empty());
        let program = program.ok_or_else(|| wrong(Fault::EmptyCommand))?;
        if program.contains('/') {
            let full = folder.join(program);
            // A path that is not UTF-8 stays as it is: the kernel then looks below the working directory.
            let full = full.to_str().unwrap_or(program).to_owned();
            words[0] = full;
        }
        match is_executable(&words[0], path) {
            true => Ok(words),
            false => Err(wrong(Fault::NoSuchProgram(words.swap_remove(0)))),
        }
    }

    /// The variables of a program. `params` stands for one of them.
    fn environment(
        &self,
        table: &ProgramTable,
        params: Option<&Spanned<PathBuf>>,
    ) -> Result<Vec<(String, String)>, UpError> {
        let mut all = Vec::new();
        if let Some(params) = params {
            let path = self.folder.join(params.get_ref());
            let file = params::File::load(&path);
            file.map_err(|error| self.wrong(&params.span(), Fault::Params(error)))?;
            let path = path.to_string_lossy().into_owned();
            all.push((FILE_VARIABLE.to_owned(), path));
        }
        for (name, value) in &table.environment {
            let text = name.get_ref();
            if text.is_empty() || text.contains('=') {
                return Err(self.wrong(&name.span(), Fault::Variable(text.clone())));
            }
            if text.contains('\0') || value.contains('\0') {
                return Err(self.wrong(&name.span(), Fault::Zero));
            }
            all.push((text.clone(), value.clone()));
        }
        Ok(all)
    }

    fn conditions(&self, after: &[Spanned<String>]) -> Result<Vec<Expression>, UpError> {
        let parse = |text: &Spanned<String>| {
            let parsed = Expression::parse(text.get_ref());
            parsed.map_err(|reason| self.wrong(&text.span(), Fault::Expression(reason)))
        };
        after.iter().map(parse).collect()
    }
}

/// Whether there is such a program, as a path or in a folder of `path` (by default, of `$PATH`).
fn is_executable(program: &str, path: Option<&str>) -> bool {
    let may = |file: &Path| file.is_file() && access(file, AccessFlags::X_OK).is_ok();
    if program.contains('/') {
        return may(Path::new(program));
    }
    let folders = path.map(Into::into).or_else(|| env::var_os("PATH"));
    let folders = folders.unwrap_or_default();
    env::split_paths(&folders).any(|folder| may(&folder.join(program)))
}

#[cfg(test)]
mod tests;
