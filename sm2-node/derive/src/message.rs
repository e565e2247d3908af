//! Derives `Message`, through `Plain` or through an encoding.

use proc_macro2::TokenStream;
use quote::{format_ident, quote};
use syn::{DeriveInput, Error, Generics, LitStr, Result, parse_quote};

use crate::{advice, schema};

/// Expands `#[derive(Message)]`. `has_zerocopy` says whether the Cargo.toml of the type's crate names
/// zerocopy.
pub(crate) fn expand(input: &DeriveInput, has_zerocopy: bool) -> Result<TokenStream> {
    let options = Options::of(input)?;
    if let Some(lifetime) = input.generics.lifetimes().next() {
        let message = "a message owns its data: it cannot have a lifetime";
        return Err(Error::new_spanned(lifetime, message));
    }
    let schema = schema::expand(input)?;
    let message = match options.encoding {
        Encoding::Plain => match advice::for_plain_type(input, &options.name, has_zerocopy) {
            None => plain(input, &options.name),
            Some(error) => {
                let error = error.to_compile_error();
                let placeholder = advice::placeholder(input, &options.name);
                quote!(#error #placeholder)
            }
        },
        Encoding::Serde(encoding) => encoded(input, &options.name, encoding),
    };
    Ok(quote!(#schema #message))
}

fn plain(input: &DeriveInput, name: &LitStr) -> TokenStream {
    let ident = &input.ident;
    // For a generic type, the same bounds as those of zerocopy's derives.
    let generics = bounded(
        &input.generics,
        &quote! {
            ::sm2_node::zerocopy::FromBytes
                + ::sm2_node::zerocopy::IntoBytes
                + ::sm2_node::zerocopy::Immutable
                + ::sm2_node::zerocopy::KnownLayout
        },
    );
    let (params, arguments, bounds) = generics.split_for_impl();
    quote! {
        // The compiler evaluates it, though nobody uses it.
        const _: &str = ::sm2_node::schema::checked_type(#name);

        #[automatically_derived]
        impl #params ::sm2_node::Plain for #ident #arguments #bounds {
            const NAME: &'static str = #name;
        }
    }
}

fn encoded(input: &DeriveInput, name: &LitStr, encoding: &str) -> TokenStream {
    let ident = &input.ident;
    let generics = bounded(
        &input.generics,
        &quote!(::sm2_node::serde::Serialize + ::sm2_node::serde::de::DeserializeOwned),
    );
    let (params, arguments, bounds) = generics.split_for_impl();
    let to = format_ident!("to_{encoding}");
    let from = format_ident!("from_{encoding}");
    quote! {
        // The compiler evaluates it, though nobody uses it.
        const _: &str = ::sm2_node::schema::checked_type(#name);

        #[automatically_derived]
        impl #params ::sm2_node::Message for #ident #arguments #bounds {
            const NAME: &'static str = #name;
            const HASH: u64 =
                ::sm2_node::schema::message(#encoding, <Self as ::sm2_node::Schema>::HASH);
            type View = ::std::boxed::Box<Self>;

            fn schema() -> ::core::option::Option<::std::string::String> {
                ::sm2_node::schema::message_text::<Self>(#encoding)
            }

            fn bytes(
                &self,
            ) -> ::core::result::Result<::std::borrow::Cow<'_, [u8]>, ::sm2_node::EncodeError> {
                ::sm2_node::encoding::#to(self)
            }

            fn view(
                payload: ::sm2_node::Payload,
            ) -> ::core::result::Result<Self::View, ::sm2_node::PayloadError> {
                ::sm2_node::encoding::#from(&payload)
            }
        }
    }
}

fn bounded(generics: &Generics, traits: &TokenStream) -> Generics {
    let mut generics = generics.clone();
    if generics.type_params().next().is_some() {
        let bounds = generics.make_where_clause();
        let this = quote!(Self: #traits + ::sm2_node::Schema);
        bounds.predicates.push(parse_quote!(#this));
        bounds
            .predicates
            .push(parse_quote!(Self: ::core::marker::Send + ::core::marker::Sync + 'static));
    }
    generics
}

enum Encoding {
    Plain,
    /// An encoding with functions in `sm2_node::encoding`.
    Serde(&'static str),
}

struct Options {
    name: LitStr,
    encoding: Encoding,
}

impl Options {
    fn of(input: &DeriveInput) -> Result<Self> {
        let mut name = None;
        let mut encoding = Encoding::Plain;
        for attribute in input
            .attrs
            .iter()
            .filter(|it| it.path().is_ident("message"))
        {
            attribute.parse_nested_meta(|meta| {
                if meta.path.is_ident("name") {
                    name = Some(meta.value()?.parse()?);
                } else if meta.path.is_ident("encoding") {
                    encoding = encoding_of(&meta.value()?.parse()?)?;
                } else {
                    return Err(meta.error("unknown option: use `name` or `encoding`"));
                }
                Ok(())
            })?;
        }
        let name = name.ok_or_else(|| {
            let message = "a message type needs a name: add #[message(name = \"sensor/Imu\")]";
            Error::new_spanned(&input.ident, message)
        })?;
        Ok(Self { name, encoding })
    }
}

fn encoding_of(name: &LitStr) -> Result<Encoding> {
    match name.value().as_str() {
        "plain" => Ok(Encoding::Plain),
        "postcard" => Ok(Encoding::Serde("postcard")),
        "json" if cfg!(feature = "json") => Ok(Encoding::Serde("json")),
        "json" => {
            let message = "the encoding \"json\" needs the feature `json` of sm2-node: \
                           add it to `features` in Cargo.toml";
            Err(Error::new_spanned(name, message))
        }
        _ => {
            let message = "unknown encoding: use \"plain\" (the default), \"postcard\" or \"json\"";
            Err(Error::new_spanned(name, message))
        }
    }
}

#[cfg(test)]
mod tests;
