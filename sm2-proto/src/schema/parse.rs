//! Reads a schema text into its tree. Reading is strict, so that each schema has exactly one text.

use alloc::{boxed::Box, collections::BTreeSet, vec::Vec};

use super::{
    definition::{Definition, RIHS01},
    tree::{Encoding, Field, Root, Scalar, Type, Variant},
};
use crate::limits::{SCHEMA_DEPTH_MAX, SCHEMA_TEXT_MAX};

/// The longest name of an encoding, in bytes.
const ENCODING_NAME_MAX: usize = 32;

/// The first error of a text that is not that of a schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a schema text: {reason}, at byte {at}")]
pub struct ParseError {
    /// The offset of the error, in bytes.
    pub at: usize,
    /// The rule that the text breaks there.
    pub reason: Reason,
}

/// The rule that a text breaks which is not that of a schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// The whole text is too long.
    #[error("it is longer than {SCHEMA_TEXT_MAX} bytes")]
    TooLong,
    /// Too many brackets are open.
    #[error("it is nested more than {SCHEMA_DEPTH_MAX} deep")]
    TooDeep,
    /// The text does not begin with the name of an encoding.
    #[error("expected the name of an encoding: 1 to {ENCODING_NAME_MAX} of a-z, 0-9, `-`, `_`")]
    Encoding,
    /// No type has this name.
    #[error("expected a type, such as u8, string or struct{{…}}")]
    Type,
    /// A field or variant has no name, or its name has an illegal character.
    #[error("expected a name")]
    Name,
    /// Two fields, or two variants, have the same name.
    #[error("this name is there already")]
    NameTwice,
    /// The length of an array is malformed.
    #[error("expected 16 hexadecimal digits, 0-9 and a-f")]
    Length,
    /// Only one character can follow, and another one does.
    #[error("expected `{0}`")]
    Expected(char),
    /// The hash of a definition is malformed.
    #[error("expected {RIHS01} and 64 hexadecimal digits, 0-9 and a-f")]
    Rihs01,
    /// A definition has a control character, or an empty line.
    #[error("expected a character of a definition: a printable one, or a line feed behind one")]
    Character,
    /// The schema ends before the text.
    #[error("expected the end")]
    End,
}

//= SM2-TYP-001
pub(super) fn schema(text: &str) -> Result<(Encoding, Root), ParseError> {
    let mut parser = Parser {
        text,
        at: 0,
        depth: 0,
    };
    if text.len() > SCHEMA_TEXT_MAX {
        return Err(parser.wrong(Reason::TooLong));
    }
    let name =
        parser.take_while(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "-_".contains(c));
    if name.is_empty() || name.len() > ENCODING_NAME_MAX {
        return Err(ParseError {
            at: 0,
            reason: Reason::Encoding,
        });
    }
    let encoding = Encoding::named(name);
    parser.expect(':')?;
    let root = match encoding {
        Encoding::Cdr => Root::Definition(parser.definition()?),
        _ => Root::Type(parser.ty()?),
    };
    if parser.at < text.len() {
        return Err(parser.wrong(Reason::End));
    }
    Ok((encoding, root))
}

/// Whether a field or variant can have this name. Programs can ask at compile time.
#[must_use]
pub const fn is_name(text: &str) -> bool {
    let bytes = text.as_bytes();
    let mut at = 0;
    // A constant function has no iterators.
    while at < bytes.len() {
        let is_legal = match bytes[at] {
            // U+0080 to U+009F: C2 and a byte below A0.
            0xc2 => bytes[at + 1] >= 0xa0,
            // Another byte of a character from U+00A0 on.
            0x80.. => true,
            ascii => is_name_char(ascii as char),
        };
        if !is_legal {
            return false;
        }
        at += 1;
    }
    !bytes.is_empty()
}

/// The rule needs no tables of Unicode. A program that prints names has to escape unprintable
/// characters.
const fn is_name_char(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '\u{a0}'..)
}

const fn is_hex_digit(c: char) -> bool {
    matches!(c, '0'..='9' | 'a'..='f')
}

/// The 32 bytes that 64 hexadecimal digits stand for.
fn bytes_of(digits: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    let (pairs, []) = digits.as_bytes().as_chunks::<2>() else {
        return None;
    };
    if pairs.len() != bytes.len() {
        return None;
    }
    for (byte, pair) in bytes.iter_mut().zip(pairs) {
        let pair = core::str::from_utf8(pair).ok()?;
        *byte = u8::from_str_radix(pair, 16).ok()?;
    }
    Some(bytes)
}

/// The rule needs no tables of Unicode, like that for names.
const fn is_definition_char(c: char) -> bool {
    matches!(c, ' '..='~' | '\u{a0}'..)
}

/// Reads the text in one pass. `depth` bounds the stack, and the length of the text bounds the
/// memory: each node of the tree takes at least two bytes of text.
struct Parser<'a> {
    text: &'a str,
    at: usize,
    /// The number of open brackets.
    depth: usize,
}

impl<'a> Parser<'a> {
    /// A line with the hash, and lines of text until the end.
    //= SM2-TYP-002
    fn definition(&mut self) -> Result<Definition, ParseError> {
        let at = self.at;
        let wrong = ParseError {
            at,
            reason: Reason::Rihs01,
        };
        let digits = self.rest().strip_prefix(RIHS01).ok_or(wrong)?;
        self.at = self.text.len() - digits.len();
        let digits = self.take_while(is_hex_digit);
        let rihs01 = bytes_of(digits).ok_or(wrong)?;
        self.expect('\n')?;
        let text = self.rest().into();
        while !self.rest().is_empty() {
            if self.take_while(is_definition_char).is_empty() {
                return Err(self.wrong(Reason::Character));
            }
            match self.rest().chars().next() {
                Some(c) if c != '\n' => return Err(self.wrong(Reason::Character)),
                _ => self.expect('\n')?,
            }
        }
        Ok(Definition { rihs01, text })
    }

    fn ty(&mut self) -> Result<Type, ParseError> {
        let start = self.at;
        match self.take_while(|c| c.is_ascii_lowercase() || c.is_ascii_digit()) {
            "string" => Ok(Type::Text),
            "struct" => Ok(Type::Struct(self.fields()?)),
            "enum" => Ok(Type::Enum(self.variants()?)),
            "array" => self.inside(|it| {
                let element = Box::new(it.ty()?);
                it.expect(';')?;
                let len = it.len()?;
                Ok(Type::Array { element, len })
            }),
            "list" => self.inside(|it| Ok(Type::List(Box::new(it.ty()?)))),
            "set" => self.inside(|it| Ok(Type::Set(Box::new(it.ty()?)))),
            "map" => self.inside(|it| {
                let key = Box::new(it.ty()?);
                it.expect(',')?;
                let value = Box::new(it.ty()?);
                Ok(Type::Map { key, value })
            }),
            "option" => self.inside(|it| Ok(Type::Option(Box::new(it.ty()?)))),
            word => match Scalar::ALL.iter().find(|it| it.name() == word) {
                Some(scalar) => Ok(Type::Scalar(*scalar)),
                None => Err(ParseError {
                    at: start,
                    reason: Reason::Type,
                }),
            },
        }
    }

    fn fields(&mut self) -> Result<Vec<Field>, ParseError> {
        self.members(|it, name| {
            let ty = it.ty()?;
            Ok(Field { name, ty })
        })
    }

    fn variants(&mut self) -> Result<Vec<Variant>, ParseError> {
        self.members(|it, name| {
            for c in "struct".chars() {
                it.expect(c)?;
            }
            let fields = it.fields()?;
            Ok(Variant { name, fields })
        })
    }

    /// `{name:…,name:…,}`
    fn members<M>(
        &mut self,
        mut member: impl FnMut(&mut Self, Box<str>) -> Result<M, ParseError>,
    ) -> Result<Vec<M>, ParseError> {
        self.open('{')?;
        let mut names = BTreeSet::new();
        let mut members = Vec::new();
        while !self.rest().starts_with('}') {
            let at = self.at;
            let name = self.take_while(is_name_char);
            if name.is_empty() {
                return Err(self.wrong(Reason::Name));
            }
            if !names.insert(name) {
                let reason = Reason::NameTwice;
                return Err(ParseError { at, reason });
            }
            self.expect(':')?;
            members.push(member(self, name.into())?);
            self.expect(',')?;
        }
        self.close('}')?;
        Ok(members)
    }

    /// `[…]`
    fn inside(
        &mut self,
        content: impl FnOnce(&mut Self) -> Result<Type, ParseError>,
    ) -> Result<Type, ParseError> {
        self.open('[')?;
        let content = content(self)?;
        self.close(']')?;
        Ok(content)
    }

    fn len(&mut self) -> Result<u64, ParseError> {
        let at = self.at;
        let digits = self.take_while(is_hex_digit);
        match u64::from_str_radix(digits, 16) {
            Ok(len) if digits.len() == 16 => Ok(len),
            _ => Err(ParseError {
                at,
                reason: Reason::Length,
            }),
        }
    }

    fn open(&mut self, bracket: char) -> Result<(), ParseError> {
        if self.depth == SCHEMA_DEPTH_MAX {
            return Err(self.wrong(Reason::TooDeep));
        }
        self.depth += 1;
        self.expect(bracket)
    }

    fn close(&mut self, bracket: char) -> Result<(), ParseError> {
        self.depth -= 1;
        self.expect(bracket)
    }

    fn expect(&mut self, expected: char) -> Result<(), ParseError> {
        if !self.rest().starts_with(expected) {
            return Err(self.wrong(Reason::Expected(expected)));
        }
        self.at += expected.len_utf8();
        Ok(())
    }

    fn take_while(&mut self, belongs: impl Fn(char) -> bool) -> &'a str {
        let rest = self.rest();
        let len = rest.find(|c| !belongs(c)).unwrap_or(rest.len());
        self.at += len;
        &rest[..len]
    }

    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    const fn wrong(&self, reason: Reason) -> ParseError {
        let at = self.at;
        ParseError { at, reason }
    }
}
