//! The code for one field: its type, its default value, and how it is written and read.

use proc_macro2::{Literal, TokenStream};
use quote::quote;
use sm2_ros_idl::{Base, Field, FieldType, Primitive, Shape, TypeName};

use crate::names::ident;
use crate::value;

/// The path of a type in Rust.
pub(crate) type PathOf<'a> = &'a dyn Fn(&TypeName) -> TokenStream;

/// The paths of types in Rust, from the two places that refer to them.
#[derive(Clone, Copy)]
pub(crate) struct Paths<'a> {
    /// From the module of a type.
    pub(crate) of_type: PathOf<'a>,
    /// From the module `view` inside.
    pub(crate) of_view: PathOf<'a>,
}

/// The type of a field in Rust.
pub(crate) fn ty(ty: &FieldType, path: PathOf<'_>) -> TokenStream {
    let base = base(&ty.base, path);
    match ty.shape {
        Shape::One => base,
        Shape::Array(len) => {
            let len = Literal::u32_unsuffixed(len);
            quote!([#base; #len])
        }
        Shape::Sequence(_) => quote!(::std::vec::Vec<#base>),
    }
}

pub(crate) fn base(base: &Base, path: PathOf<'_>) -> TokenStream {
    match base {
        Base::Primitive(primitive) => self::primitive(*primitive),
        Base::String { .. } | Base::WString { .. } => quote!(::std::string::String),
        Base::Message(name) => path(name),
    }
}

/// The type of a constant in Rust.
pub(crate) fn constant_type(base: &Base) -> TokenStream {
    match base {
        Base::Primitive(primitive) => self::primitive(*primitive),
        _ => quote!(&'static str),
    }
}

fn primitive(primitive: Primitive) -> TokenStream {
    match primitive {
        Primitive::Bool => quote!(bool),
        Primitive::Byte | Primitive::Char | Primitive::Uint8 => quote!(u8),
        Primitive::Int8 => quote!(i8),
        Primitive::Int16 => quote!(i16),
        Primitive::Uint16 => quote!(u16),
        Primitive::Int32 => quote!(i32),
        Primitive::Uint32 => quote!(u32),
        Primitive::Int64 => quote!(i64),
        Primitive::Uint64 => quote!(u64),
        Primitive::Float32 => quote!(f32),
        Primitive::Float64 => quote!(f64),
    }
}

/// Whether the derive of `Default` gives the default value of this field.
pub(crate) const fn has_derived_default(field: &Field) -> bool {
    field.default.is_none() && !matches!(field.ty.shape, Shape::Array(_))
}

/// The default value of a field; `None` if the definition has one that does not fit the type.
pub(crate) fn default(field: &Field) -> Option<TokenStream> {
    let Field { ty, default, .. } = field;
    let zero = quote!(::core::default::Default::default());
    let is_text = matches!(ty.base, Base::String { .. } | Base::WString { .. });
    let owned = |literal| match is_text {
        true => quote!(::std::string::String::from(#literal)),
        false => literal,
    };
    let Some(text) = default else {
        return Some(match (ty.shape, &ty.base) {
            (Shape::Array(len), Base::Primitive(_)) => {
                let zero = value::literal(&ty.base, "0")?;
                let len = Literal::u32_unsuffixed(len);
                quote!([#zero; #len])
            }
            (Shape::Array(_), _) => quote!(::core::array::from_fn(|_| #zero)),
            _ => zero,
        });
    };
    if ty.shape == Shape::One {
        return value::literal(&ty.base, text).map(owned);
    }
    let items = value::literals(&ty.base, text)?;
    let fits = match ty.shape {
        Shape::Array(len) => items.len() == len as usize,
        Shape::Sequence(max) => max.is_none_or(|max| items.len() <= max as usize),
        Shape::One => false,
    };
    let is_array = matches!(ty.shape, Shape::Array(_));
    let items = items.into_iter().map(owned);
    let list = match is_array {
        true => quote!([#(#items),*]),
        false => quote!(::std::vec![#(#items),*]),
    };
    fits.then_some(list)
}

/// The least number of bytes of a field, as an expression.
pub(crate) fn min_bytes(ty: &FieldType, path: PathOf<'_>) -> TokenStream {
    match ty.shape {
        Shape::One => element_min_bytes(&ty.base, path),
        Shape::Array(len) => {
            let len = Literal::u32_unsuffixed(len);
            let element = element_min_bytes(&ty.base, path);
            quote!(#len * #element)
        }
        Shape::Sequence(_) => quote!(4),
    }
}

fn element_min_bytes(base: &Base, path: PathOf<'_>) -> TokenStream {
    let bytes = match base {
        Base::Primitive(primitive) => primitive.size_bytes(),
        Base::String { .. } | Base::WString { .. } => 4,
        Base::Message(name) => {
            let path = path(name);
            return quote!(<#path as ::sm2_ros::cdr::Cdr>::MIN_BYTES);
        }
    };
    let bytes = Literal::usize_unsuffixed(bytes);
    quote!(#bytes)
}

/// The statement that writes a field.
pub(crate) fn write(field: &Field) -> TokenStream {
    let ident = ident(&field.name);
    let place = quote!(self.#ident);
    let FieldType { base, shape } = &field.ty;
    let is_number = is_number(base);
    let written = match shape {
        Shape::One if is_number => return quote!(writer.number(#place);),
        Shape::One if is_bool(base) => return quote!(writer.bool(#place);),
        Shape::Array(_) if is_number => return quote!(writer.numbers(&#place);),
        Shape::One => write_element(base, &quote!(&#place)),
        Shape::Sequence(max) if is_number => {
            let max = option(*max);
            quote!(writer.number_sequence(&#place, #max))
        }
        Shape::Array(_) => {
            let element = write_element(base, &quote!(item));
            quote!(writer.each(&#place, |writer, item| #element))
        }
        Shape::Sequence(max) => {
            let element = write_element(base, &quote!(item));
            let max = option(*max);
            quote!(writer.sequence(&#place, #max, |writer, item| #element))
        }
    };
    let name = &*field.name;
    quote!(#written.map_err(|error| error.within(#name))?;)
}

/// The expression that writes an element other than a number, which is given as a reference.
fn write_element(base: &Base, item: &TokenStream) -> TokenStream {
    match base {
        Base::Primitive(_) => quote!({
            writer.bool(*#item);
            ::core::result::Result::Ok(())
        }),
        Base::String { max_bytes } => {
            let max = option(*max_bytes);
            quote!(writer.text(#item, #max))
        }
        Base::WString { max_units } => {
            let max = option(*max_units);
            quote!(writer.wide_text(#item, #max))
        }
        Base::Message(_) => quote!(::sm2_ros::cdr::Cdr::write(#item, writer)),
    }
}

/// The expression that reads a field.
pub(crate) fn read(field: &Field, path: PathOf<'_>) -> TokenStream {
    let FieldType { base, shape } = &field.ty;
    let element = read_element(base);
    let is_number = is_number(base);
    let read = match shape {
        Shape::One => element,
        Shape::Array(_) if is_number => quote!(reader.number_array()),
        Shape::Array(_) => quote!(reader.array(|reader| #element)),
        Shape::Sequence(max) => {
            let max = option(*max);
            match is_number {
                true => quote!(reader.number_sequence(#max)),
                false => {
                    let min_bytes = element_min_bytes(base, path);
                    quote!(reader.sequence(#max, #min_bytes, |reader| #element))
                }
            }
        }
    };
    let name = &*field.name;
    quote!(#read.map_err(|error| error.within(#name))?)
}

fn read_element(base: &Base) -> TokenStream {
    match base {
        Base::Primitive(Primitive::Bool) => quote!(reader.bool()),
        Base::Primitive(_) => quote!(reader.number()),
        Base::String { max_bytes } => {
            let max = option(*max_bytes);
            quote!(reader.string(#max))
        }
        Base::WString { max_units } => {
            let max = option(*max_units);
            quote!(reader.wide_string(#max))
        }
        Base::Message(_) => quote!(::sm2_ros::cdr::Cdr::read(reader)),
    }
}

const fn is_bool(base: &Base) -> bool {
    matches!(base, Base::Primitive(Primitive::Bool))
}

pub(crate) const fn is_number(base: &Base) -> bool {
    matches!(base, Base::Primitive(_)) && !is_bool(base)
}

pub(crate) fn option(max: Option<u32>) -> TokenStream {
    match max.map(Literal::u32_unsuffixed) {
        Some(max) => quote!(::core::option::Option::Some(#max)),
        None => quote!(::core::option::Option::None),
    }
}
