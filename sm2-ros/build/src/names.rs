//! Names in Rust.

use proc_macro2::{Ident, Span};
use sm2_ros_idl::{Set, TypeName};

/// The identifier of a field, constant or package. Keywords become raw identifiers; the four that cannot be raw get a
/// `_` behind them.
pub(crate) fn ident(name: &str) -> Ident {
    match syn::parse_str::<Ident>(name) {
        Ok(ident) => ident,
        Err(_) if matches!(name, "self" | "Self" | "super" | "crate" | "_") => {
            Ident::new(&format!("{name}_"), Span::call_site())
        }
        Err(_) => Ident::new_raw(name, Span::call_site()),
    }
}

/// The name of a type in Rust: without the `_` of `AddTwoInts_Request`.
pub(crate) fn type_name(name: &TypeName) -> String {
    name.name().split('_').map(upper_first).collect()
}

fn upper_first(part: &str) -> String {
    let mut chars = part.chars();
    match chars.next() {
        Some(first) => first.to_ascii_uppercase().to_string() + chars.as_str(),
        None => String::new(),
    }
}

/// The kind of a type in a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// A message, with bytes of its own.
    Message,
    /// A service, which consists of two messages.
    Service,
    /// An action, which consists of messages and services.
    Action,
}

impl Role {
    pub(crate) fn of(name: &TypeName, set: &Set) -> Self {
        let has = |suffix: &str| part(name, suffix).is_some_and(|it| set.get(&it).is_ok());
        // A definition has all parts of its service or action, so one tells.
        match name.kind() {
            sm2_ros_idl::Kind::Msg => Self::Message,
            _ if has("_Request") => Self::Service,
            _ if has("_SendGoal") => Self::Action,
            _ => Self::Message,
        }
    }
}

/// The type of the same package and kind whose name has this suffix.
pub(crate) fn part(name: &TypeName, suffix: &str) -> Option<TypeName> {
    let part = format!("{}{suffix}", name.name());
    TypeName::new(name.package(), name.kind(), &part).ok()
}
