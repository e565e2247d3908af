//! Derives `Schema`: hash and text of a type's structure, as expressions of those of its fields.

use std::collections::BTreeSet;

use proc_macro2::TokenStream;
use quote::{quote, quote_spanned};
use syn::spanned::Spanned;
use syn::{Data, DataEnum, DeriveInput, Error, Fields, Generics, Result, Type, parse_quote};

use crate::serde::{Options, Rule};

pub(crate) fn expand(input: &DeriveInput) -> Result<TokenStream> {
    let options = Options::of(&input.attrs)?;
    let Expressions { hash, describe } = match &input.data {
        Data::Struct(data) if options.transparent => transparent(&data.fields)?,
        Data::Struct(data) => {
            let Members { hashes, parts } = members(&data.fields, options.rename_all)?;
            Expressions {
                hash: quote!(::sm2_node::schema::structure(&[#(#hashes),*])),
                describe: quote!(::sm2_node::schema::describe_structure(text, &[#(#parts),*])),
            }
        }
        Data::Enum(data) => enumeration(data, &options)?,
        Data::Union(data) => {
            let message = "a union has no schema: its bytes do not say which field is in use";
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

            fn describe(text: &mut ::std::string::String) -> bool {
                #describe
            }
        }
    })
}

/// The expressions that make up an `impl Schema`.
struct Expressions {
    hash: TokenStream,
    describe: TokenStream,
}

/// Each field's name, with the hash and the description of its type.
struct Members {
    hashes: Vec<TokenStream>,
    parts: Vec<TokenStream>,
}

fn transparent(fields: &Fields) -> Result<Expressions> {
    let mut fields = fields.iter();
    let (Some(field), None) = (fields.next(), fields.next()) else {
        let message = "the schema of a transparent type is that of its only field: \
                       implement `Schema` by hand";
        return Err(Error::new(proc_macro2::Span::call_site(), message));
    };
    Options::of(&field.attrs)?;
    let ty = &field.ty;
    Ok(Expressions {
        hash: quote_spanned!(ty.span()=> <#ty as ::sm2_node::Schema>::HASH),
        describe: quote_spanned!(ty.span()=> <#ty as ::sm2_node::Schema>::describe(text)),
    })
}

fn enumeration(data: &DataEnum, options: &Options) -> Result<Expressions> {
    let mut names = Names::default();
    let (mut hashes, mut variants) = (Vec::new(), Vec::new());
    for variant in &data.variants {
        let own = Options::of(&variant.attrs)?;
        let name = text_of(&variant.ident);
        let name = own
            .rename
            .or_else(|| Some(options.rename_all?.variant(&name)))
            .unwrap_or(name);
        names.add(&name, &variant.ident)?;
        let rule = own.rename_all.or(options.rename_all_fields);
        let Members {
            hashes: fields,
            parts,
        } = members(&variant.fields, rule)?;
        hashes.push(quote_spanned!(variant.ident.span()=> (
            ::sm2_node::schema::checked_member(#name),
            ::sm2_node::schema::structure(&[#(#fields),*])
        )));
        variants.push(quote!((#name, &[#(#parts),*])));
    }
    Ok(Expressions {
        hash: quote!(::sm2_node::schema::enumeration(&[#(#hashes),*])),
        describe: quote!(::sm2_node::schema::describe_enumeration(text, &[#(#variants),*])),
    })
}

/// Collects the fields with their names. Fields of a tuple are named by position.
fn members(fields: &Fields, rule: Option<Rule>) -> Result<Members> {
    let mut names = Names::default();
    let (mut hashes, mut parts) = (Vec::new(), Vec::new());
    for (position, field) in fields.iter().enumerate() {
        let options = Options::of(&field.attrs)?;
        let ty = &field.ty;
        let name = match &field.ident {
            Some(ident) => {
                let name = text_of(ident);
                options
                    .rename
                    .or_else(|| Some(rule?.field(&name)))
                    .unwrap_or(name)
            }
            None => position.to_string(),
        };
        names.add(&name, field)?;
        // The field's span, so that a type without a schema is reported there.
        hashes.push(quote_spanned!(ty.span()=> (
            ::sm2_node::schema::checked_member(#name),
            <#ty as ::sm2_node::Schema>::HASH
        )));
        parts.push(quote_spanned!(ty.span()=>
            (#name, <#ty as ::sm2_node::Schema>::describe as ::sm2_node::schema::Describe)
        ));
    }
    Ok(Members { hashes, parts })
}

/// The names of a type's fields or variants, to find duplicates.
#[derive(Default)]
struct Names(BTreeSet<String>);

impl Names {
    /// Adds a name. Refuses names that renaming made equal. The compiler checks the names themselves.
    fn add(&mut self, name: &str, place: &impl quote::ToTokens) -> Result<()> {
        if !self.0.insert(name.to_owned()) {
            let message = format!("the name {name:?} is used twice");
            return Err(Error::new_spanned(place, message));
        }
        Ok(())
    }
}

fn text_of(ident: &syn::Ident) -> String {
    let text = ident.to_string();
    text.strip_prefix("r#").map_or(text.clone(), str::to_owned)
}

/// Adds a bound to each type parameter: a generic type has a schema if its fields have one.
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

#[cfg(test)]
mod tests;
