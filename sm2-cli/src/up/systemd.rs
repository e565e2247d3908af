//! `sm2 up --systemd`: a user unit for each program, instead of starting it.

use std::{
    env,
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

use super::{
    error::UpError,
    file::MANAGER,
    limits::{FIRST_DELAY, STABLE},
    robot::{Program, Robot},
};
use crate::{ended::Ended, error::CliError, output::Output};

/// The first line of each unit. A file that begins otherwise is not overwritten.
const MARK: &str = "# Written by `sm2 up --systemd`.";

/// The units of a robot.
pub(super) struct Units<'a> {
    pub(super) robot: &'a Robot,
    /// The path of the program `sm2`.
    pub(super) itself: &'a Path,
    pub(super) socket: &'a Path,
}

impl Units<'_> {
    /// Writes the units to a folder, by default that of the user, and prints their paths.
    ///
    /// # Errors
    ///
    /// [`UpError`], [`CliError::File`], [`CliError::Output`].
    pub(super) fn write(&self, folder: Option<&Path>) -> Result<Ended, CliError> {
        let folder = folder.map(Path::to_owned).or_else(user_folder);
        let folder = folder.ok_or(UpError::NoUnitFolder)?;
        let units = self.units();
        for (name, _) in &units {
            let path = folder.join(name);
            let is_ours = |text: Vec<u8>| text.starts_with(MARK.as_bytes());
            if path.exists() && !fs::read(&path).is_ok_and(is_ours) {
                return Err(UpError::ForeignUnit { path }.into());
            }
        }
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |error| CliError::file("write", &path, error)
        };
        fs::create_dir_all(&folder).map_err(failed(&folder))?;
        let mut out = Output::new();
        for (name, text) in units {
            let path = folder.join(name);
            fs::write(&path, text).map_err(failed(&path))?;
            out.line(path.display())?;
        }
        stderr_line!(
            "start all: systemctl --user daemon-reload && systemctl --user start {}.target",
            self.prefix()
        );
        Ok(Ended::Done)
    }

    /// The names and texts of the units.
    fn units(&self) -> Vec<(String, String)> {
        let programs = self.robot.programs.iter();
        let mut names: Vec<_> = programs.clone().map(|it| self.unit(&it.name)).collect();
        let mut units: Vec<_> = programs
            .map(|it| (self.unit(&it.name), self.program(it)))
            .collect();
        if self.robot.has_manager {
            let name = self.unit(MANAGER);
            units.insert(0, (name.clone(), self.manager()));
            names.insert(0, name);
        }
        let target = format!(
            "{MARK}\n\n[Unit]\nDescription=Robot {}\nWants={}\n\n[Install]\nWantedBy=default.target\n",
            self.robot.name,
            names.join(" ")
        );
        units.push((format!("{}.target", self.prefix()), target));
        units
    }

    /// The beginning of the names of all units: the name of the file.
    fn prefix(&self) -> String {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
        let name = self.robot.name.chars();
        name.map(|c| if is_plain(c) { c } else { '_' }).collect()
    }

    fn unit(&self, name: &str) -> String {
        format!("{}-{name}.service", self.prefix())
    }

    fn manager(&self) -> String {
        let command = ["manager", "--standby", "--socket"].map(str::to_owned);
        let command = [&[path(self.itself)], &command[..], &[path(self.socket)]].concat();
        let mut text = self.head("SM2 Manager");
        text += "StartLimitIntervalSec=0\n\n[Service]\nType=notify\n";
        line(&mut text, "ExecStart", &words(&command));
        text += "Restart=always\nRestartSec=100ms\n";
        text
    }

    fn program(&self, program: &Program) -> String {
        let mut text = self.head(&program.name);
        if self.robot.has_manager {
            let manager = self.unit(MANAGER);
            let _ = writeln!(text, "Wants={manager}\nAfter={manager}");
        }
        // As many starts within this time as one restart after the other can have.
        let burst = program.max_restarts.saturating_add(1);
        let interval = STABLE.as_secs().saturating_mul(u64::from(burst));
        let _ = writeln!(
            text,
            "StartLimitIntervalSec={interval}\nStartLimitBurst={burst}"
        );
        text += "\n[Service]\nType=exec\n";
        line(
            &mut text,
            "WorkingDirectory",
            &path(&program.folder).replace('%', "%%"),
        );
        let socket = ("SM2_SOCKET".to_owned(), path(self.socket));
        for (name, value) in [&socket].into_iter().chain(&program.environment) {
            line(
                &mut text,
                "Environment",
                &quoted(&format!("{name}={value}"), false),
            );
        }
        if !program.after.is_empty() {
            let options = [
                "wait",
                "--socket",
                &path(self.socket),
                "--wait-manager",
                "8760h",
            ];
            let conditions = program.after.iter().map(|it| it.text());
            let command = [path(self.itself)].into_iter();
            let command = command.chain(options.into_iter().chain(conditions).map(str::to_owned));
            line(
                &mut text,
                "ExecStartPre",
                &words(&command.collect::<Vec<_>>()),
            );
            text += "TimeoutStartSec=infinity\n";
        }
        line(&mut text, "ExecStart", &words(&program.command));
        let _ = writeln!(text, "Restart={}", program.policy.word());
        let _ = writeln!(text, "RestartSec={}ms", FIRST_DELAY.as_millis());
        let timeout = self.robot.stop_timeout.as_millis();
        let _ = writeln!(text, "TimeoutStopSec={timeout}ms");
        text
    }

    fn head(&self, what: &str) -> String {
        let target = self.prefix();
        format!(
            "{MARK}\n\n[Unit]\nDescription={what} of robot {}\nPartOf={target}.target\n",
            self.robot.name.replace('%', "%%")
        )
    }
}

/// The folder of the user's units.
fn user_folder() -> Option<PathBuf> {
    let variable = |name| {
        env::var_os(name)
            .filter(|it| !it.is_empty())
            .map(PathBuf::from)
    };
    let home = || variable("HOME").map(|home| home.join(".config"));
    let configuration = variable("XDG_CONFIG_HOME").or_else(home)?;
    Some(configuration.join("systemd/user"))
}

fn path(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

fn line(text: &mut String, key: &str, value: &str) {
    let _ = writeln!(text, "{key}={value}");
}

/// A command line.
fn words(words: &[String]) -> String {
    let quoted = words.iter().map(|word| quoted(word, true));
    quoted.collect::<Vec<_>>().join(" ")
}

/// A word in quotes of systemd. It has escapes, specifiers such as `%h`, and in commands variables such as `$HOME`.
fn quoted(word: &str, is_command: bool) -> String {
    let mut quoted = String::from("\"");
    for c in word.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            '%' => quoted += "%%",
            '$' if is_command => quoted += "$$",
            '\n' => quoted += "\\n",
            '\t' => quoted += "\\t",
            c if c.is_control() => {
                let _ = write!(quoted, "\\x{:02x}", u32::from(c));
            }
            c => quoted.push(c),
        }
    }
    quoted + "\""
}

#[cfg(test)]
mod tests;
