//! Names of types: `package/msg/Name`.

use std::fmt;
use std::str::FromStr;

/// The kind of a definition, which is the middle part of a type's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// `action`, from an `.action` file.
    Action,
    /// `msg`, from a `.msg` file.
    Msg,
    /// `srv`, from a `.srv` file.
    Srv,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Action, Self::Msg, Self::Srv];

    /// The name of the kind. It is also the extension of its files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Action => "action",
            Self::Msg => "msg",
            Self::Srv => "srv",
        }
    }
}

/// The full name of a type, such as `sensor_msgs/msg/Image`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeName {
    package: Box<str>,
    kind: Kind,
    name: Box<str>,
}

/// A text that is not the name of a type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not the name of a type: write it as package/msg/Name")]
pub struct NameError {
    /// The text.
    pub text: String,
}

/// The longest package name and the longest own name of a type, in bytes. With both, the full name still is a
/// name of SM2-NAM-001.
const PART_MAX_BYTES: usize = 120;

impl TypeName {
    /// Combines the parts of a name.
    ///
    /// # Errors
    ///
    /// [`NameError`] if a part is empty, too long, or has illegal characters.
    pub fn new(package: &str, kind: Kind, name: &str) -> Result<Self, NameError> {
        if !is_part(package) || !is_part(name) {
            let kind = kind.name();
            let text = format!("{package}/{kind}/{name}");
            return Err(NameError { text });
        }
        Ok(Self {
            package: package.into(),
            kind,
            name: name.into(),
        })
    }

    /// The package.
    #[must_use]
    pub const fn package(&self) -> &str {
        &self.package
    }

    /// The kind of the definition.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        self.kind
    }

    /// The name inside its package.
    #[must_use]
    pub const fn name(&self) -> &str {
        &self.name
    }

    /// Reads a reference from inside a definition: `Name`, `package/Name` or `package/msg/Name`.
    pub(crate) fn referred(text: &str, package: &str) -> Result<Self, NameError> {
        let wrong = || NameError {
            text: text.to_owned(),
        };
        let mut parts = text.split('/');
        match (parts.next(), parts.next(), parts.next(), parts.next()) {
            (Some(name), None, ..) => Self::new(package, Kind::Msg, name),
            (Some(package), Some(name), None, _) => Self::new(package, Kind::Msg, name),
            (Some(_), Some(_), Some(_), None) => text.parse(),
            _ => Err(wrong()),
        }
    }

    /// The type of the same package and kind whose name has this suffix.
    pub(crate) fn suffixed(&self, suffix: &str) -> Result<Self, NameError> {
        Self::new(&self.package, self.kind, &format!("{}{suffix}", self.name))
    }
}

fn is_part(text: &str) -> bool {
    let is_char = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.len() <= PART_MAX_BYTES
        && text.chars().all(is_char)
}

impl FromStr for TypeName {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let wrong = || NameError {
            text: text.to_owned(),
        };
        let mut parts = text.split('/');
        let (Some(package), Some(kind), Some(name), None) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(wrong());
        };
        let kind = Kind::ALL.into_iter().find(|it| it.name() == kind);
        Self::new(package, kind.ok_or_else(wrong)?, name)
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind.name(), self.name)
    }
}
