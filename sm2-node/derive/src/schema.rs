//! `impl Schema`: the hash of a type's structure, as an expression of its fields' hashes.

use proc_macro2::TokenStream;
use quote::{quote, quote_spanned};
use syn::spanned::Spanned;
use syn::{Attribute, Data, DeriveInput, Error, Fields, Generics, Result, Type, parse_quote};

/// What serde can be told about a field or type that changes its encoding, and
/// that the hash would not see.
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

pub(crate) fn expand(input: &DeriveInput) -> Result<TokenStream> {
    check_serde(&input.attrs)?;
    let hash = match &input.data {
        Data::Struct(data) => structure(&data.fields)?,
        Data::Enum(data) => {
            let variants = data
                .variants
                .iter()
                .map(|variant| {
                    check_serde(&variant.attrs)?;
                    let name = text_of(&variant.ident);
                    let fields = structure(&variant.fields)?;
                    Ok(quote!((#name, #fields)))
                })
                .collect::<Result<Vec<_>>>()?;
            quote!(::sm2_node::schema::enumeration(&[#(#variants),*]))
        }
        Data::Union(data) => {
            let message = "a union has no schema: its bytes do not say which field they are";
            return Err(Error::new(data.union_token.span(), message));
        }
    };
    let name = &input.ident;
    let generics = bounded(&input.generics, &input.data);
    let (params, arguments, bounds) = generics.split_for_impl();
    Ok(quote! {
        #[automatically_derived]
        impl #params ::sm2_node::Schema for #name #arguments #bounds {
            const HASH: u64 = #hash;
        }
    })
}

/// The hash of named fields; those of a tuple are named by their position.
fn structure(fields: &Fields) -> Result<TokenStream> {
    let fields = fields
        .iter()
        .enumerate()
        .map(|(position, field)| {
            check_serde(&field.attrs)?;
            let name = field
                .ident
                .as_ref()
                .map_or_else(|| position.to_string(), text_of);
            let ty = &field.ty;
            // The field's span, so that a type without a schema is reported there.
            Ok(quote_spanned!(ty.span()=> (#name, <#ty as ::sm2_node::Schema>::HASH)))
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(quote!(::sm2_node::schema::structure(&[#(#fields),*])))
}

fn text_of(ident: &syn::Ident) -> String {
    let text = ident.to_string();
    text.strip_prefix("r#").map_or(text.clone(), str::to_owned)
}

/// A generic type has a schema where its fields have one.
fn bounded(generics: &Generics, data: &Data) -> Generics {
    let mut generics = generics.clone();
    if generics.type_params().next().is_some() {
        let bounds = generics.make_where_clause();
        for ty in field_types(data) {
            bounds
                .predicates
                .push(parse_quote!(#ty: ::sm2_node::Schema));
        }
    }
    generics
}

fn field_types(data: &Data) -> Vec<&Type> {
    let fields: Vec<&Fields> = match data {
        Data::Struct(data) => vec![&data.fields],
        Data::Enum(data) => data.variants.iter().map(|it| &it.fields).collect(),
        Data::Union(_) => Vec::new(),
    };
    fields
        .into_iter()
        .flatten()
        .map(|field| &field.ty)
        .collect()
}

fn check_serde(attributes: &[Attribute]) -> Result<()> {
    for attribute in attributes.iter().filter(|it| it.path().is_ident("serde")) {
        attribute.parse_nested_meta(|meta| {
            if let Some(found) = ENCODING_CHANGES
                .iter()
                .find(|name| meta.path.is_ident(name))
            {
                return Err(meta.error(format!(
                    "`{found}` changes the encoding in a way that the schema hash cannot see: \
                     implement `Schema` by hand, or leave it out"
                )));
            }
            // Skip the value, if there is one.
            if meta.input.peek(syn::Token![=]) {
                meta.value()?.parse::<syn::Expr>()?;
            } else if meta.input.peek(syn::token::Paren) {
                meta.parse_nested_meta(|nested| {
                    if nested.input.peek(syn::Token![=]) {
                        nested.value()?.parse::<syn::Expr>()?;
                    }
                    Ok(())
                })?;
            }
            Ok(())
        })?;
    }
    Ok(())
}
