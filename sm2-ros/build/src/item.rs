//! The code for one type: a structure with its implementations, or the name of a service or action.

use proc_macro2::{Ident, Literal, Span, TokenStream};
use quote::quote;
use sm2_ros_idl::{Message, Set, SetError, TypeName};

use crate::field::{self, PathOf, Paths};
use crate::names::{ident, part, type_name};
use crate::view::{View, view};

/// A constant or a default value that does not fit its type.
pub(crate) struct WrongValue<'a> {
    /// The name of the constant or field.
    pub(crate) member: &'a str,
    pub(crate) ty: String,
    pub(crate) value: &'a str,
}

/// The code for a message.
pub(crate) struct MessageCode {
    pub(crate) items: TokenStream,
    /// The structure for the module `view`.
    pub(crate) view: Option<TokenStream>,
}

/// The code for a message, apart from its constants and default values the same for all.
pub(crate) fn message<'a>(
    message: &'a Message,
    set: &Set,
    paths: Paths<'_>,
) -> Result<Result<MessageCode, WrongValue<'a>>, SetError> {
    let (hash, schema) = (set.hash(&message.name)?.0, set.schema_text(&message.name)?);
    let structure = match structure(message, paths.of_type) {
        Ok(structure) => structure,
        Err(wrong) => return Ok(Err(wrong)),
    };
    let (name, rust) = (message.name.to_string(), rust_ident(&message.name));
    let bytes = hash.map(Literal::u8_unsuffixed);
    let cdr = cdr(message, &rust, paths.of_type);
    let View {
        structure: view,
        implementation: viewed,
    } = view(message, &rust, set, paths)?;
    let items = quote! {
        #structure
        #cdr
        #viewed

        impl ::sm2_ros::Type for #rust {
            const TYPE_NAME: &'static str = #name;
            const RIHS01: [u8; 32] = [#(#bytes),*];
            const SCHEMA: &'static str = #schema;
        }

        ::sm2_ros::__message!(#rust);
    };
    Ok(Ok(MessageCode { items, view }))
}

pub(crate) fn rust_ident(name: &TypeName) -> Ident {
    Ident::new(&type_name(name), Span::call_site())
}

fn structure<'a>(message: &'a Message, path: PathOf<'_>) -> Result<TokenStream, WrongValue<'a>> {
    let rust = rust_ident(&message.name);
    let doc = doc(&message.name.to_string(), &message.comment);
    let fields = message.fields.iter().map(|field| {
        let (ident, ty) = (ident(&field.name), field::ty(&field.ty, path));
        let doc = self::doc(&format!("{} {}", field.ty, field.name), &field.comment);
        quote! {
            #[doc = #doc]
            pub #ident: #ty
        }
    });
    let constants = constants(message, &rust)?;
    let is_derived = message.fields.iter().all(field::has_derived_default);
    let (derived, default) = match is_derived {
        true => (quote!(, Default), TokenStream::new()),
        false => (TokenStream::new(), default(message, &rust)?),
    };
    Ok(quote! {
        #[doc = #doc]
        #[derive(Clone, Debug, PartialEq #derived)]
        pub struct #rust {
            #(#fields),*
        }
        #constants
        #default
    })
}

/// The documentation of an item: its definition, and the comment there. rustdoc shows the comment as it is, because it
/// is no Markdown.
fn doc(definition: &str, comment: &str) -> String {
    if comment.is_empty() {
        return format!(" `{definition}`");
    }
    // Nothing in the comment may end the block.
    let comment = comment.replace("```", "'''");
    format!(" `{definition}`\n\n```text\n{comment}\n```")
}

fn constants<'a>(message: &'a Message, rust: &Ident) -> Result<TokenStream, WrongValue<'a>> {
    if message.constants.is_empty() {
        return Ok(TokenStream::new());
    }
    let constants = message.constants.iter().map(|constant| {
        let value = crate::value::literal(&constant.ty, &constant.value);
        let value = value.ok_or_else(|| WrongValue {
            member: &constant.name,
            ty: constant.ty.to_string(),
            value: &constant.value,
        })?;
        let (ident, ty) = (ident(&constant.name), field::constant_type(&constant.ty));
        let definition = format!("{} {}={}", constant.ty, constant.name, constant.value);
        let doc = doc(&definition, &constant.comment);
        Ok(quote! {
            #[doc = #doc]
            pub const #ident: #ty = #value;
        })
    });
    let constants = constants.collect::<Result<Vec<_>, _>>()?;
    Ok(quote! {
        impl #rust {
            #(#constants)*
        }
    })
}

fn default<'a>(message: &'a Message, rust: &Ident) -> Result<TokenStream, WrongValue<'a>> {
    let fields = message.fields.iter().map(|field| {
        let value = field::default(field).ok_or_else(|| WrongValue {
            member: &field.name,
            ty: field.ty.to_string(),
            value: field.default.as_deref().unwrap_or_default(),
        })?;
        let ident = ident(&field.name);
        Ok(quote!(#ident: #value))
    });
    let fields = fields.collect::<Result<Vec<_>, _>>()?;
    Ok(quote! {
        #[allow(clippy::derivable_impls)]
        impl ::core::default::Default for #rust {
            fn default() -> Self {
                Self { #(#fields),* }
            }
        }
    })
}

fn cdr(message: &Message, rust: &Ident, path: PathOf<'_>) -> TokenStream {
    let (min_bytes, write, read) = match message.fields.as_slice() {
        // IDL has no structure without fields: ROS 2 sends a byte.
        [] => (
            vec![quote!(1)],
            vec![quote!(writer.number(0_u8);)],
            quote!(reader.number::<u8>().map(|_| Self {})),
        ),
        fields => {
            let read = fields.iter().map(|field| {
                let (ident, read) = (ident(&field.name), field::read(field, path));
                quote!(#ident: #read)
            });
            (
                fields
                    .iter()
                    .map(|it| field::min_bytes(&it.ty, path))
                    .collect(),
                fields.iter().map(field::write).collect(),
                quote!(::core::result::Result::Ok(Self { #(#read),* })),
            )
        }
    };
    quote! {
        impl ::sm2_ros::cdr::Cdr for #rust {
            #[allow(clippy::identity_op)]
            const MIN_BYTES: usize = #(#min_bytes)+*;

            fn write<S: ::sm2_ros::cdr::Sink>(
                &self,
                writer: &mut ::sm2_ros::cdr::Writer<S>,
            ) -> ::core::result::Result<(), ::sm2_ros::EncodeError> {
                #(#write)*
                ::core::result::Result::Ok(())
            }

            fn read<S: ::sm2_ros::cdr::Source>(
                reader: &mut ::sm2_ros::cdr::Reader<S>,
            ) -> ::core::result::Result<Self, ::sm2_ros::DecodeError> {
                #read
            }
        }
    }
}

/// The code for a service, whose messages have code of their own.
pub(crate) fn service(name: &TypeName, path: PathOf<'_>) -> TokenStream {
    let parts = [
        ("Request", "_Request"),
        ("Response", "_Response"),
        ("Event", "_Event"),
    ];
    marker(name, "service", &quote!(Service), &parts, path)
}

/// The code for an action, whose messages and services have code of their own.
pub(crate) fn action(name: &TypeName, path: PathOf<'_>) -> TokenStream {
    let parts = [
        ("Goal", "_Goal"),
        ("Result", "_Result"),
        ("Feedback", "_Feedback"),
        ("FeedbackMessage", "_FeedbackMessage"),
        ("SendGoal", "_SendGoal"),
        ("GetResult", "_GetResult"),
    ];
    marker(name, "action", &quote!(Action), &parts, path)
}

fn marker(
    name: &TypeName,
    kind: &str,
    implemented: &TokenStream,
    parts: &[(&str, &str)],
    path: PathOf<'_>,
) -> TokenStream {
    let (rust, full) = (rust_ident(name), name.to_string());
    let doc = format!(" The {kind} `{name}`.");
    let types = parts.iter().filter_map(|(label, suffix)| {
        let (label, path) = (ident(label), path(&part(name, suffix)?));
        Some(quote!(type #label = #path;))
    });
    quote! {
        #[doc = #doc]
        #[derive(Clone, Copy, Debug)]
        pub enum #rust {}

        impl ::sm2_ros::#implemented for #rust {
            const NAME: &'static str = #full;
            #(#types)*
        }
    }
}
