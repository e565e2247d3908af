//! Constants and default values, which definitions write as text.

use proc_macro2::{Literal, TokenStream};
use quote::quote;
use sm2_ros_idl::{Base, Primitive};

/// A value as a Rust literal; `None` if it is not a value of the type. Texts are literals of type `&str`.
pub(crate) fn literal(base: &Base, text: &str) -> Option<TokenStream> {
    match base {
        Base::Primitive(primitive) => number(*primitive, text),
        Base::String { max_bytes } => bounded(unquoted(text), *max_bytes, str::len),
        Base::WString { max_units } => {
            bounded(unquoted(text), *max_units, |it| it.encode_utf16().count())
        }
        Base::Message(_) => None,
    }
}

/// The elements of a default value of an array or sequence: `[1, 2]`, `["a", "b"]`.
pub(crate) fn literals(base: &Base, text: &str) -> Option<Vec<TokenStream>> {
    let inner = text.strip_prefix('[')?.strip_suffix(']')?.trim();
    if inner.is_empty() {
        return Some(Vec::new());
    }
    let items = split(inner);
    items.iter().map(|it| literal(base, it.trim())).collect()
}

/// Splits at commas outside of quotes.
fn split(text: &str) -> Vec<&str> {
    let mut items = Vec::new();
    let (mut quote, mut start) = (None, 0);
    for (at, c) in text.char_indices() {
        match (quote, c) {
            (None, ',') => {
                items.push(&text[start..at]);
                start = at + 1;
            }
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), _) if open == c => quote = None,
            _ => {}
        }
    }
    items.push(&text[start..]);
    items
}

fn bounded(text: &str, max: Option<u32>, len: impl Fn(&str) -> usize) -> Option<TokenStream> {
    let fits = max.is_none_or(|max| len(text) <= max as usize);
    fits.then(|| quote!(#text))
}

fn number(primitive: Primitive, text: &str) -> Option<TokenStream> {
    macro_rules! integer {
        ($type:ty, $literal:ident) => {
            Literal::$literal(<$type>::try_from(integer(text)?).ok()?)
        };
    }
    let literal = match primitive {
        Primitive::Bool => {
            return match text {
                "true" | "True" | "TRUE" | "1" => Some(quote!(true)),
                "false" | "False" | "FALSE" | "0" => Some(quote!(false)),
                _ => None,
            };
        }
        Primitive::Byte | Primitive::Char | Primitive::Uint8 => integer!(u8, u8_unsuffixed),
        Primitive::Int8 => integer!(i8, i8_unsuffixed),
        Primitive::Uint16 => integer!(u16, u16_unsuffixed),
        Primitive::Int16 => integer!(i16, i16_unsuffixed),
        Primitive::Uint32 => integer!(u32, u32_unsuffixed),
        Primitive::Int32 => integer!(i32, i32_unsuffixed),
        Primitive::Uint64 => integer!(u64, u64_unsuffixed),
        Primitive::Int64 => integer!(i64, i64_unsuffixed),
        Primitive::Float32 => {
            let number = text.parse::<f32>().ok().filter(|it| it.is_finite());
            Literal::f32_unsuffixed(number?)
        }
        Primitive::Float64 => {
            let number = text.parse::<f64>().ok().filter(|it| it.is_finite());
            Literal::f64_unsuffixed(number?)
        }
    };
    Some(quote!(#literal))
}

/// A whole number, decimal, hexadecimal (`0x`), octal (`0o`) or binary (`0b`).
fn integer(text: &str) -> Option<i128> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let radixes = [("0x", 16), ("0X", 16), ("0o", 8), ("0b", 2)];
    let found = radixes
        .iter()
        .find_map(|(prefix, radix)| Some((digits.strip_prefix(prefix)?, *radix)));
    let (digits, radix) = found.unwrap_or((digits, 10));
    if digits.starts_with(['+', '-']) {
        return None;
    }
    // 64 bits are the most that a type has, so the product does not overflow.
    Some(sign * i128::from(u64::from_str_radix(digits, radix).ok()?))
}

fn unquoted(text: &str) -> &str {
    let inner = |quote| text.strip_prefix(quote)?.strip_suffix(quote);
    inner('"').or_else(|| inner('\'')).unwrap_or(text)
}
