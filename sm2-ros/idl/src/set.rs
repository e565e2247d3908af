//! A set of types.

use std::collections::{BTreeMap, BTreeSet};

use crate::{Base, DefinitionError, Message, SetError, TypeName, interface};

/// Types that refer to each other.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Set {
    types: BTreeMap<TypeName, Message>,
}

/// How many types can be inside each other.
const DEPTH_MAX: usize = 64;

impl Set {
    /// Reads the text of a `.msg`, `.srv` or `.action` file, and adds the types that it defines. The kind of
    /// `name` says which of the three it is. Types with the same names are replaced.
    ///
    /// # Errors
    ///
    /// [`DefinitionError`] with the line that is wrong.
    pub fn add(&mut self, name: &TypeName, text: &str) -> Result<(), DefinitionError> {
        for message in interface::messages(name, text)? {
            self.insert(message);
        }
        Ok(())
    }

    pub(crate) fn insert(&mut self, message: Message) {
        self.types.insert(message.name.clone(), message);
    }

    /// The types, in the order of their names.
    pub fn types(&self) -> impl Iterator<Item = &Message> {
        self.types.values()
    }

    /// The type of this name.
    ///
    /// # Errors
    ///
    /// [`SetError::Unknown`].
    pub fn get(&self, name: &TypeName) -> Result<&Message, SetError> {
        let unknown = || SetError::Unknown(name.clone());
        self.types.get(name).ok_or_else(unknown)
    }

    /// A type and all types that it refers to, directly or not. A type comes after the types of its fields, so
    /// the last one is the type itself.
    ///
    /// # Errors
    ///
    /// [`SetError`] if a type is missing, contains itself, or is nested too deeply.
    pub fn closure(&self, name: &TypeName) -> Result<Vec<&Message>, SetError> {
        let mut done = BTreeSet::new();
        let mut order = Vec::new();
        // The types from `name` to the one that is being visited, with the number of fields that are visited.
        let mut open = vec![(self.get(name)?, 0)];
        while let Some((message, at)) = open.last_mut() {
            let message = *message;
            let Some(field) = message.fields.get(*at) else {
                open.pop();
                done.insert(&message.name);
                order.push(message);
                continue;
            };
            *at += 1;
            let Base::Message(part) = &field.ty.base else {
                continue;
            };
            if done.contains(part) {
                continue;
            }
            let Some(part) = self.types.get(part) else {
                return Err(SetError::Missing {
                    user: message.name.clone(),
                    missing: part.clone(),
                });
            };
            if open.iter().any(|(it, _)| it.name == part.name) {
                return Err(SetError::Cycle(part.name.clone()));
            }
            if open.len() == DEPTH_MAX {
                return Err(SetError::TooDeep(name.clone()));
            }
            open.push((part, 0));
        }
        Ok(order)
    }
}
