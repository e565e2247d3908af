//! The serde attributes of a type: those that its schema follows, and those that it cannot follow.

use syn::meta::ParseNestedMeta;
use syn::{Attribute, Ident, LitStr, Result, Token, token};

/// Attributes of a field or type that change its encoding without changing the hash.
const ENCODING_CHANGES: &[&str] = &[
    "content",
    "deserialize_with",
    "flatten",
    "from",
    "into",
    "remote",
    "serialize_with",
    "skip",
    "skip_deserializing",
    "skip_serializing",
    "skip_serializing_if",
    "tag",
    "try_from",
    "untagged",
    "with",
];

/// The attributes that change names or remove a level of structure.
#[derive(Default)]
pub(crate) struct Options {
    pub(crate) rename: Option<String>,
    pub(crate) rename_all: Option<Rule>,
    pub(crate) rename_all_fields: Option<Rule>,
    pub(crate) transparent: bool,
}

impl Options {
    pub(crate) fn of(attributes: &[Attribute]) -> Result<Self> {
        let mut options = Self::default();
        for attribute in attributes.iter().filter(|it| it.path().is_ident("serde")) {
            attribute.parse_nested_meta(|meta| options.add(&meta))?;
        }
        Ok(options)
    }

    fn add(&mut self, meta: &ParseNestedMeta<'_>) -> Result<()> {
        let name = meta.path.get_ident().map(Ident::to_string);
        match name.as_deref() {
            Some("rename") => self.rename = Some(value(meta)?.value()),
            Some("rename_all") => self.rename_all = Some(Rule::of(&value(meta)?)?),
            Some("rename_all_fields") => self.rename_all_fields = Some(Rule::of(&value(meta)?)?),
            Some("transparent") => self.transparent = true,
            Some(name) if ENCODING_CHANGES.contains(&name) => {
                return Err(meta.error(format!(
                    "`{name}` changes the encoding in a way that the schema hash cannot see: \
                     remove it, or implement `Schema` by hand"
                )));
            }
            _ => skip_value(meta)?,
        }
        Ok(())
    }
}

fn value(meta: &ParseNestedMeta<'_>) -> Result<LitStr> {
    if meta.input.peek(token::Paren) {
        let message = "a schema has one name for both directions: write `rename… = \"…\"`";
        return Err(meta.error(message));
    }
    meta.value()?.parse()
}

fn skip_value(meta: &ParseNestedMeta<'_>) -> Result<()> {
    if meta.input.peek(Token![=]) {
        meta.value()?.parse::<syn::Expr>()?;
    } else if meta.input.peek(token::Paren) {
        meta.parse_nested_meta(|nested| skip_value(&nested))?;
    }
    Ok(())
}

/// A `rename_all` rule of serde.
#[derive(Clone, Copy)]
pub(crate) enum Rule {
    Lower,
    Upper,
    Pascal,
    Camel,
    Snake,
    ScreamingSnake,
    Kebab,
    ScreamingKebab,
}

impl Rule {
    fn of(name: &LitStr) -> Result<Self> {
        Ok(match name.value().as_str() {
            "lowercase" => Self::Lower,
            "UPPERCASE" => Self::Upper,
            "PascalCase" => Self::Pascal,
            "camelCase" => Self::Camel,
            "snake_case" => Self::Snake,
            "SCREAMING_SNAKE_CASE" => Self::ScreamingSnake,
            "kebab-case" => Self::Kebab,
            "SCREAMING-KEBAB-CASE" => Self::ScreamingKebab,
            _ => {
                return Err(syn::Error::new_spanned(
                    name,
                    "unknown rule: use one of serde's, such as \"camelCase\"",
                ));
            }
        })
    }

    /// Applies the rule to a variant, which is written `LikeThis`.
    pub(crate) fn variant(self, name: &str) -> String {
        match self {
            Self::Pascal => name.to_owned(),
            Self::Lower => name.to_ascii_lowercase(),
            Self::Upper => name.to_ascii_uppercase(),
            Self::Camel => first_lower(name),
            Self::Snake => {
                let mut snake = String::new();
                for (at, c) in name.char_indices() {
                    if at > 0 && c.is_uppercase() {
                        snake.push('_');
                    }
                    snake.push(c.to_ascii_lowercase());
                }
                snake
            }
            Self::ScreamingSnake => Self::Snake.variant(name).to_ascii_uppercase(),
            Self::Kebab => Self::Snake.variant(name).replace('_', "-"),
            Self::ScreamingKebab => Self::ScreamingSnake.variant(name).replace('_', "-"),
        }
    }

    /// Applies the rule to a field, which is written `like_this`.
    pub(crate) fn field(self, name: &str) -> String {
        match self {
            Self::Lower | Self::Snake => name.to_owned(),
            Self::Upper | Self::ScreamingSnake => name.to_ascii_uppercase(),
            Self::Pascal => {
                let mut pascal = String::new();
                let mut begins = true;
                for c in name.chars() {
                    match (c, begins) {
                        ('_', _) => begins = true,
                        (c, true) => {
                            pascal.push(c.to_ascii_uppercase());
                            begins = false;
                        }
                        (c, false) => pascal.push(c),
                    }
                }
                pascal
            }
            Self::Camel => first_lower(&Self::Pascal.field(name)),
            Self::Kebab => name.replace('_', "-"),
            Self::ScreamingKebab => Self::ScreamingSnake.field(name).replace('_', "-"),
        }
    }
}

fn first_lower(name: &str) -> String {
    let mut chars = name.chars();
    let first = chars.next().map(|c| c.to_ascii_lowercase());
    first.into_iter().chain(chars).collect()
}
