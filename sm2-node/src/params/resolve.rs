//! The first values of a node's parameters. No I/O.

use std::collections::{HashMap, HashSet};

use super::environment::{Lookup, variable};
use super::error::ParametersError;
use super::file::{ALL_NODES, File, FileValue};
use super::limits::{PARAMETERS_MAX, TEXT_MAX};
use super::table::{Entry, Origin, Table, check_name};
use super::value::Value;

/// Checks what a program has declared, and gives the parameters their first values. A later file has precedence over an
/// earlier one, and the environment over all files.
//= SM2-PRM-006
pub(super) fn resolve(
    mut parameters: Vec<Entry>,
    node: &str,
    files: &[File],
    environment: Lookup<'_>,
    time_ns: u64,
) -> Result<Table, ParametersError> {
    check_declared(&parameters)?;
    let entries = parameters.iter().enumerate();
    let index: HashMap<_, _> = entries.map(|(at, it)| (it.name.clone(), at)).collect();
    for file in files {
        for value in file.values(ALL_NODES) {
            if let Some(&at) = index.get(&value.name) {
                from_file(&mut parameters[at], file, value)?;
            }
        }
        for value in file.values(node) {
            match index.get(&value.name) {
                Some(&at) => from_file(&mut parameters[at], file, value)?,
                None => {
                    return Err(ParametersError::Unknown {
                        path: file.path().to_owned(),
                        line: value.line,
                        node: node.to_owned(),
                        name: value.name.clone(),
                    });
                }
            }
        }
    }
    from_environment(&mut parameters, environment)?;
    let table = Table {
        revision: 1,
        time_ns,
        parameters,
    };
    table.check_len().map_err(ParametersError::Default)?;
    Ok(table)
}

/// Checks names, descriptions, ranges and defaults.
fn check_declared(parameters: &[Entry]) -> Result<(), ParametersError> {
    let count = parameters.len();
    //= SM2-PRM-004
    if count > PARAMETERS_MAX {
        return Err(ParametersError::TooMany { count });
    }
    let mut names = HashSet::new();
    for entry in parameters {
        let name = || entry.name.clone();
        if let Err(reason) = check_name(&entry.name) {
            return Err(ParametersError::Name {
                name: name(),
                reason,
            });
        }
        if !names.insert(entry.name.as_str()) {
            return Err(ParametersError::Twice { name: name() });
        }
        if entry.description.len() > TEXT_MAX {
            return Err(ParametersError::Description { name: name() });
        }
        if let Some(range) = entry.range.filter(|it| !it.is_valid()) {
            return Err(ParametersError::Range {
                name: name(),
                range,
            });
        }
        let default = entry.check(&entry.value);
        default.map_err(ParametersError::Default)?;
    }
    Ok(())
}

fn from_file(entry: &mut Entry, file: &File, given: &FileValue) -> Result<(), ParametersError> {
    let (path, line) = (|| file.path().to_owned(), given.line);
    let value = given.read(entry.kind());
    let value = value.map_err(|reason| ParametersError::FileValue {
        path: path(),
        line,
        name: given.name.clone(),
        reason,
    })?;
    let taken = take(entry, value, Origin::File);
    taken.map_err(|refusal| ParametersError::FileRefused {
        path: path(),
        line,
        refusal,
    })
}

fn from_environment(
    parameters: &mut [Entry],
    environment: Lookup<'_>,
) -> Result<(), ParametersError> {
    let mut owners: HashMap<String, String> = HashMap::new();
    for entry in parameters {
        let name = entry.name.clone();
        let variable = variable(&name);
        let Some(text) = environment(&variable) else {
            continue;
        };
        if let Some(first) = owners.insert(variable.clone(), name.clone()) {
            return Err(ParametersError::VariableOfTwo {
                variable,
                first,
                second: name,
            });
        }
        let Ok(text) = text.into_string() else {
            return Err(ParametersError::VariableText { variable });
        };
        match entry.kind().parse(&text) {
            Err(reason) => {
                return Err(ParametersError::VariableValue {
                    variable,
                    name,
                    reason,
                });
            }
            Ok(value) => {
                let taken = take(entry, value, Origin::Environment);
                taken.map_err(|refusal| ParametersError::VariableRefused { variable, refusal })?;
            }
        }
    }
    Ok(())
}

fn take(entry: &mut Entry, value: Value, origin: Origin) -> Result<(), super::refusal::Refusal> {
    entry.check(&value)?;
    entry.value = value;
    entry.origin = origin;
    Ok(())
}
