//! `mutants [--list | --quick | NAME...]`: makes the named faults of `mutants.toml`, or all of them, and
//! shows the check that finds each. `--quick` leaves out those marked `full`. If
//! `SM2_VERIFICATION_RESULTS` names a file, a line for each fault is added to it.
//!
//! Exit status: 0 if all faults were found, 1 if one was not found or cannot be made any more, 2 for an
//! unknown name or if nothing could be run.

use std::{
    env,
    io::{self, Write as _},
    path::{self, Path, PathBuf},
    process::ExitCode,
    time::Instant,
};

use sm2_verification::{
    mutants::{Campaign, Catalogue, Mutant},
    results, workspace,
};

const USAGE: &str = "usage: mutants [--list | --quick | NAME...]
Makes faults in a copy of the workspace, and shows which check finds each.
  --list   only say which there are
  --quick  leave out those marked `full`";

fn main() -> ExitCode {
    match run() {
        Ok(status) => status,
        Err(error) => {
            let _ = writeln!(io::stderr().lock(), "mutants: {error}");
            ExitCode::from(2)
        }
    }
}

fn run() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let arguments = env::args().skip(1);
    let (options, names): (Vec<_>, Vec<_>) = arguments.partition(|it| it.starts_with('-'));
    let root = workspace();
    let catalogue = Catalogue::load(&root)?;
    let mut out = io::stdout().lock();
    let mut quick = false;
    for option in &options {
        match option.as_str() {
            "--list" => {
                list(&mut out, &catalogue)?;
                return Ok(ExitCode::SUCCESS);
            }
            "--quick" => quick = true,
            _ => {
                writeln!(io::stderr().lock(), "{USAGE}")?;
                return Ok(ExitCode::from(2));
            }
        }
    }
    if let Some(unknown) = names.iter().find(|it| catalogue.named(it).is_none()) {
        writeln!(io::stderr().lock(), "there is no mutant {unknown}\n{USAGE}")?;
        return Ok(ExitCode::from(2));
    }
    let gaps = catalogue.gaps(&root)?;
    for gap in &gaps {
        writeln!(out, "{gap}")?;
    }
    if !gaps.is_empty() {
        return Ok(ExitCode::FAILURE);
    }
    let wanted = |it: &&Mutant| match names.is_empty() {
        true => !(quick && it.full),
        false => names.contains(&it.name),
    };
    let mutants: Vec<&Mutant> = catalogue.mutants.iter().filter(wanted).collect();
    let killed = campaign(&mut out, &root, &mutants)?;
    Ok(ExitCode::from(u8::from(killed < mutants.len())))
}

/// Runs the mutants, and returns the number of killed ones.
fn campaign(
    out: &mut impl io::Write,
    root: &Path,
    mutants: &[&Mutant],
) -> Result<usize, Box<dyn std::error::Error>> {
    let began = Instant::now();
    let (mut killed, mut told) = (0, Ok(()));
    let campaign = Campaign::new(root, &output(root)?, mutants)?;
    let seconds = began.elapsed().as_secs();
    writeln!(out, "without a mutant: built and checked in {seconds} s")?;
    campaign.run(|outcome| {
        killed += usize::from(outcome.is_killed());
        let line = writeln!(out, "{outcome}").and_then(|()| results::append(&outcome.result()));
        told = std::mem::replace(&mut told, Ok(())).and(line);
    })?;
    told?;
    let seconds = began.elapsed().as_secs();
    writeln!(out, "{killed} of {} killed in {seconds} s", mutants.len())?;
    Ok(killed)
}

/// Prints a line for each mutant; the first word is the name.
fn list(out: &mut impl io::Write, catalogue: &Catalogue) -> io::Result<()> {
    for Mutant {
        name,
        breaks,
        properties,
        check,
        ..
    } in &catalogue.mutants
    {
        let properties = properties.join(", ");
        writeln!(out, "{name:<34} {properties}: {breaks} ({check})")?;
    }
    Ok(())
}

/// The folder for build output.
fn output(root: &Path) -> io::Result<PathBuf> {
    let named = env::var_os("CARGO_TARGET_DIR").map(PathBuf::from);
    path::absolute(named.unwrap_or_else(|| root.join("target")))
}
