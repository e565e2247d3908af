//! Errors for mistakes that rustc would report with many errors about generated code.

use std::{env, fs, path::Path};

use proc_macro2::TokenStream;
use quote::quote;
use syn::{Attribute, Data, DeriveInput, Error, Field, Fields, LitStr, Type};

/// The error for a plain type that cannot compile, if the reason is a known mistake.
pub(crate) fn for_plain_type(
    input: &DeriveInput,
    name: &LitStr,
    has_zerocopy: bool,
) -> Option<Error> {
    missing_encoding(input, name)
        .or_else(|| missing_zerocopy(input, has_zerocopy))
        .or_else(|| padding_at_end(input))
}

/// A placeholder implementation of `Message`, so that the uses of the type cause no further errors.
pub(crate) fn placeholder(input: &DeriveInput, name: &LitStr) -> TokenStream {
    let ident = &input.ident;
    let (params, arguments, bounds) = input.generics.split_for_impl();
    let predicates = bounds.map(|it| &it.predicates);
    quote! {
        #[automatically_derived]
        impl #params ::sm2_node::Message for #ident #arguments
        where
            Self: ::core::marker::Send + ::core::marker::Sync + 'static,
            #predicates
        {
            const NAME: &'static str = #name;
            const HASH: u64 = 0;
            type View = ::std::boxed::Box<Self>;

            fn bytes(
                &self,
            ) -> ::core::result::Result<::std::borrow::Cow<'_, [u8]>, ::sm2_node::EncodeError> {
                ::core::unreachable!()
            }

            fn view(
                _: ::sm2_node::Payload,
            ) -> ::core::result::Result<Self::View, ::sm2_node::PayloadError> {
                ::core::unreachable!()
            }
        }
    }
}

/// Whether the Cargo.toml of the compiled crate names another crate. True without a Cargo.toml: rustc was not
/// started by cargo then.
pub(crate) fn manifest_names(crate_name: &str) -> bool {
    let manifest = env::var("CARGO_MANIFEST_DIR")
        .ok()
        .and_then(|folder| fs::read_to_string(Path::new(&folder).join("Cargo.toml")).ok());
    manifest.is_none_or(|text| names_crate(&text, crate_name))
}

fn names_crate(manifest: &str, crate_name: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    manifest
        .split(|c| !is_part(c))
        .any(|word| word == crate_name)
}

/// zerocopy accepts no type without `repr`, so such a type was meant for serde.
fn missing_encoding(input: &DeriveInput, name: &LitStr) -> Option<Error> {
    if input.attrs.iter().any(|it| it.path().is_ident("repr")) {
        return None;
    }
    let ident = &input.ident;
    let name = name.value();
    let message = format!(
        "`{ident}` has neither an encoding nor a `repr`\n\
         for a type that serde encodes, write: #[message(name = \"{name}\", encoding = \"postcard\")]\n\
         for plain old data, write: #[repr(C)] and \
         #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]"
    );
    Some(Error::new_spanned(ident, message))
}

/// The derives of zerocopy refer to `::zerocopy` unless an attribute names another path.
fn missing_zerocopy(input: &DeriveInput, has_zerocopy: bool) -> Option<Error> {
    let names_path = input.attrs.iter().any(|it| it.path().is_ident("zerocopy"));
    if has_zerocopy || names_path {
        return None;
    }
    let message = "the derives of zerocopy need the crate `zerocopy`, which Cargo.toml does not name\n\
                   write in Cargo.toml: zerocopy = { version = \"0.8\", features = [\"derive\"] }\n\
                   or write at the type: #[zerocopy(crate = \"sm2_node::zerocopy\")]";
    Some(Error::new_spanned(&input.ident, message))
}

/// Finds a number before a list of smaller elements. The size of the structure is rounded up to the alignment
/// of the number, so some lengths of the list leave padding.
fn padding_at_end(input: &DeriveInput) -> Option<Error> {
    if !has_repr(&input.attrs, "C") || has_repr(&input.attrs, "packed") {
        return None;
    }
    let Data::Struct(data) = &input.data else {
        return None;
    };
    let Fields::Named(fields) = &data.fields else {
        return None;
    };
    let mut before: Vec<&Field> = fields.named.iter().collect();
    let list = before.pop()?;
    let Type::Slice(elements) = &list.ty else {
        return None;
    };
    let (_, element_alignment) = number(&elements.elem)?;
    let (field, number, alignment) = before.into_iter().find_map(|field| {
        let (number, alignment) = number(&field.ty)?;
        (alignment > element_alignment).then_some((field, number, alignment))
    })?;
    let [field_name, list_name] = [field, list].map(|it| it.ident.as_ref());
    let (field_name, list_name) = (field_name?, list_name?);
    let unaligned = number.to_uppercase();
    let message = format!(
        "`{field_name}` has an alignment of {alignment} bytes and the elements of `{list_name}` have \
         {element_alignment}, so the message would end in padding bytes\n\
         write `sm2_node::zerocopy::little_endian::{unaligned}` instead of `{number}`, \
         or #[repr(C, packed)] at the type"
    );
    Some(Error::new_spanned(field, message))
}

fn has_repr(attributes: &[Attribute], wanted: &str) -> bool {
    let mut found = false;
    for attribute in attributes.iter().filter(|it| it.path().is_ident("repr")) {
        // rustc reports an invalid `repr`.
        let _ = attribute.parse_nested_meta(|meta| {
            found |= meta.path.is_ident(wanted);
            if meta.input.peek(syn::token::Paren) {
                let content;
                syn::parenthesized!(content in meta.input);
                content.parse::<TokenStream>()?;
            }
            Ok(())
        });
    }
    found
}

/// The name and the alignment of a number, or of the numbers in an array.
fn number(ty: &Type) -> Option<(String, u8)> {
    let path = match ty {
        Type::Array(array) => return number(&array.elem),
        Type::Path(path) => path.path.get_ident()?.to_string(),
        _ => return None,
    };
    let alignment = match path.as_str() {
        "u8" | "i8" => 1,
        "u16" | "i16" => 2,
        "u32" | "i32" | "f32" => 4,
        "u64" | "i64" | "f64" => 8,
        "u128" | "i128" => 16,
        _ => return None,
    };
    Some((path, alignment))
}

#[cfg(test)]
mod tests;
