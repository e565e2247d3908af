//! From the tables of a policy file to those of a policy. Errors name the line and the key.

use std::{io, ops::Range, path::Path};

use nix::unistd::{Group, User};
use sm2_proto::{
    Name, WrongText,
    gateway::Pattern,
    policy::{Action, ActionSet, Binding, Exclusive, Members, Rule, Tables},
};
use toml::Spanned;

use super::{
    error::{PolicyFileError, PolicyValueError},
    lines::Lines,
    toml_file::{File, Id, List, RuleTable},
};

/// The text of a file, to turn positions into lines.
pub(super) struct Source<'a> {
    pub(super) path: &'a Path,
    pub(super) text: &'a str,
}

type Ids = Option<Spanned<Vec<Spanned<Id>>>>;

/// Looks up the id of a name; `None` if the system does not have the name.
type Lookup = fn(&str) -> nix::Result<Option<u32>>;

impl Source<'_> {
    pub(super) fn line(&self, span: &Range<usize>) -> usize {
        let before = self.text.get(..span.start).unwrap_or("");
        before.matches('\n').count() + 1
    }

    fn error(
        &self,
        span: &Range<usize>,
        key: &'static str,
        source: PolicyValueError,
    ) -> PolicyFileError {
        PolicyFileError::Value {
            path: self.path.into(),
            line: self.line(span),
            key,
            source,
        }
    }

    pub(super) fn tables(&self, file: &File) -> Result<(Tables, Lines), PolicyFileError> {
        let mut tables = Tables {
            default: file.default.into(),
            rules: Vec::new(),
            bindings: Vec::new(),
            exclusive: Vec::new(),
        };
        let mut lines = Lines::default();
        let mut names = file.names().into_iter();
        for table in &file.rule {
            let rule = table.get_ref();
            let name = self.name(names.next(), rule.name.as_ref(), &table.span())?;
            tables.rules.push(self.rule(name, rule)?);
            lines.rules.push(self.line(&table.span()));
        }
        for table in &file.binding {
            let binding = table.get_ref();
            tables.bindings.push(Binding {
                name: self.name(names.next(), binding.name.as_ref(), &table.span())?,
                nodes: self.patterns("nodes", &binding.nodes)?,
                members: self.members(&binding.users, &binding.groups)?,
            });
            lines.bindings.push(self.line(&table.span()));
        }
        for table in &file.exclusive {
            let exclusive = table.get_ref();
            tables.exclusive.push(Exclusive {
                name: self.name(names.next(), exclusive.name.as_ref(), &table.span())?,
                topics: self.patterns("topics", &exclusive.topics)?,
            });
            lines.exclusive.push(self.line(&table.span()));
        }
        Ok((tables, lines))
    }

    fn rule(&self, name: Name, table: &RuleTable) -> Result<Rule, PolicyFileError> {
        let actions = match &table.actions {
            None => ActionSet::ALL,
            Some(it) if it.get_ref().is_empty() => {
                return Err(self.error(&it.span(), "actions", PolicyValueError::Empty));
            }
            Some(it) => {
                let actions = it.get_ref().iter().map(|text| self.action(text));
                actions.collect::<Result<_, _>>()?
            }
        };
        let list = |key, it: &Option<List>| {
            let list = it.as_ref();
            list.map(|it| self.patterns(key, it)).transpose()
        };
        Ok(Rule {
            name,
            effect: table.effect.into(),
            actions,
            names: self.patterns("names", &table.names)?,
            members: self.members(&table.users, &table.groups)?,
            nodes: list("nodes", &table.nodes)?,
            peers: list("peers", &table.peers)?,
        })
    }

    fn action(&self, text: &Spanned<String>) -> Result<Action, PolicyFileError> {
        text.get_ref().parse().map_err(|source| {
            let value = text.get_ref().clone();
            let error = PolicyValueError::Action {
                text: value,
                source,
            };
            self.error(&text.span(), "actions", error)
        })
    }

    /// Checks the name of a table. `text` is that of the file, or the one that the table's number gives.
    fn name(
        &self,
        text: Option<String>,
        given: Option<&Spanned<String>>,
        table: &Range<usize>,
    ) -> Result<Name, PolicyFileError> {
        let text = text.unwrap_or_default();
        WrongText::or_name(&text).map_err(|error| {
            let span = given.map_or(table.clone(), Spanned::span);
            self.error(&span, "name", error.into())
        })
    }

    fn patterns(&self, key: &'static str, list: &List) -> Result<Vec<Pattern>, PolicyFileError> {
        if list.get_ref().is_empty() {
            return Err(self.error(&list.span(), key, PolicyValueError::Empty));
        }
        let patterns = list.get_ref().iter().map(|text| {
            let pattern = WrongText::or_pattern(text.get_ref());
            pattern.map_err(|error| self.error(&text.span(), key, error.into()))
        });
        patterns.collect()
    }

    fn members(&self, users: &Ids, groups: &Ids) -> Result<Members, PolicyFileError> {
        let user: Lookup = |name| Ok(User::from_name(name)?.map(|it| it.uid.as_raw()));
        let group: Lookup = |name| Ok(Group::from_name(name)?.map(|it| it.gid.as_raw()));
        Ok(Members {
            users: self.ids("users", users, user, |text| PolicyValueError::NoUser {
                text,
            })?,
            groups: self.ids("groups", groups, group, |text| PolicyValueError::NoGroup {
                text,
            })?,
        })
    }

    fn ids(
        &self,
        key: &'static str,
        list: &Ids,
        lookup: Lookup,
        unknown: fn(String) -> PolicyValueError,
    ) -> Result<Option<Vec<u32>>, PolicyFileError> {
        let Some(list) = list else {
            return Ok(None);
        };
        if list.get_ref().is_empty() {
            return Err(self.error(&list.span(), key, PolicyValueError::Empty));
        }
        let ids = list.get_ref().iter().map(|id| match id.get_ref() {
            Id::Number(number) => Ok(*number),
            Id::Name(text) => {
                let error = match lookup(text) {
                    Ok(Some(id)) => return Ok(id),
                    Ok(None) => unknown(text.clone()),
                    Err(errno) => PolicyValueError::Lookup {
                        text: text.clone(),
                        source: io::Error::from(errno),
                    },
                };
                Err(self.error(&id.span(), key, error))
            }
        });
        ids.collect::<Result<_, _>>().map(Some)
    }
}
