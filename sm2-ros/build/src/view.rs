//! The code for the view of a type: a structure that leaves sequences of numbers in the message.

use proc_macro2::{Ident, TokenStream};
use quote::quote;
use sm2_ros_idl::{Base, Field, Message, Set, SetError, Shape};

use crate::field::{self, PathOf, Paths};
use crate::names::ident;

/// The view of a message: its structure for the module `view`, unless the type is its own view, and its implementation.
pub(crate) struct View {
    pub(crate) structure: Option<TokenStream>,
    pub(crate) implementation: TokenStream,
}

/// The code for a type that is the structure `rust`.
pub(crate) fn view(
    message: &Message,
    rust: &Ident,
    set: &Set,
    paths: Paths<'_>,
) -> Result<View, SetError> {
    let parts = set.closure(&message.name)?;
    if !parts.iter().any(|it| it.fields.iter().any(has_numbers)) {
        let implementation = implementation(
            rust,
            &quote!(Self),
            &quote!(<Self as ::sm2_ros::cdr::Cdr>::read(reader)),
        );
        return Ok(View {
            structure: None,
            implementation,
        });
    }
    let types = message.fields.iter().map(|field| {
        let (ident, ty) = (ident(&field.name), ty(field, paths.of_view));
        let doc = format!(" `{} {}`", field.ty, field.name);
        quote! {
            #[doc = #doc]
            pub #ident: #ty
        }
    });
    let doc = format!(" The [view](::sm2_ros::Viewed) of `{}`.", message.name);
    let structure = quote! {
        #[doc = #doc]
        #[derive(Clone, Debug)]
        pub struct #rust<'a> {
            #(#types),*
        }
    };
    let fields = message.fields.iter().map(|field| {
        let (ident, read) = (ident(&field.name), read(field, paths.of_type));
        quote!(#ident: #read)
    });
    let read = quote!(::core::result::Result::Ok(view::#rust { #(#fields),* }));
    Ok(View {
        structure: Some(structure),
        implementation: implementation(rust, &quote!(view::#rust<'a>), &read),
    })
}

fn implementation(rust: &Ident, view: &TokenStream, read: &TokenStream) -> TokenStream {
    quote! {
        impl ::sm2_ros::Viewed for #rust {
            type View<'a> = #view;

            fn view<'a>(
                reader: &mut ::sm2_ros::cdr::Reader<&'a [u8]>,
            ) -> ::core::result::Result<Self::View<'a>, ::sm2_ros::DecodeError> {
                #read
            }
        }
    }
}

/// Whether a field is a sequence of numbers.
fn has_numbers(field: &Field) -> bool {
    matches!(field.ty.shape, Shape::Sequence(_)) && field::is_number(&field.ty.base)
}

/// The type of a field of the view.
fn ty(field: &Field, path: PathOf<'_>) -> TokenStream {
    let ty = match &field.ty.base {
        _ if has_numbers(field) => {
            let number = field::base(&field.ty.base, path);
            return quote!(::sm2_ros::cdr::Numbers<'a, #number>);
        }
        Base::Message(name) => {
            let path = path(name);
            quote!(<#path as ::sm2_ros::Viewed>::View<'a>)
        }
        _ => return field::ty(&field.ty, path),
    };
    match field.ty.shape {
        Shape::One => ty,
        Shape::Array(_) | Shape::Sequence(_) => quote!(::std::vec::Vec<#ty>),
    }
}

/// The expression that reads a field of the view.
fn read(field: &Field, path: PathOf<'_>) -> TokenStream {
    let name = &*field.name;
    let read = match (&field.ty.base, field.ty.shape) {
        (_, Shape::Sequence(max)) if has_numbers(field) => {
            let max = field::option(max);
            quote!(reader.number_view(#max))
        }
        (Base::Message(part), shape) => {
            let part = path(part);
            let element = quote!(<#part as ::sm2_ros::Viewed>::view(reader));
            match shape {
                Shape::One => element,
                Shape::Array(len) => {
                    let len = len as usize;
                    quote!(reader.elements(#len, |reader| #element))
                }
                Shape::Sequence(max) => {
                    let max = field::option(max);
                    let min = quote!(<#part as ::sm2_ros::cdr::Cdr>::MIN_BYTES);
                    quote!(reader.sequence(#max, #min, |reader| #element))
                }
            }
        }
        _ => return field::read(field, path),
    };
    quote!(#read.map_err(|error| error.within(#name))?)
}
