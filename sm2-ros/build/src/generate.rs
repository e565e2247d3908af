//! The modules of the generated file: `package::kind::Type`.

use std::collections::BTreeMap;

use proc_macro2::TokenStream;
use quote::quote;
use sm2_ros_idl::{Kind, Message, Set, TypeName};

use crate::Error;
use crate::field::Paths;
use crate::item::{self, WrongValue};
use crate::names::{Role, ident, type_name};
use crate::packages::Packages;
use crate::size::{SIZE_MAX_BYTES, size_bytes};

/// The code of one module, with the names in Rust of its types.
#[derive(Default)]
struct Module<'a> {
    items: Vec<TokenStream>,
    views: Vec<TokenStream>,
    names: BTreeMap<String, &'a TypeName>,
}

/// Generates the code of all packages that have no module elsewhere.
pub(crate) fn code(set: &Set, packages: &Packages) -> Result<String, Error> {
    let mut modules = BTreeMap::<_, BTreeMap<Kind, Module<'_>>>::new();
    let mut visits = Vec::new();
    let types = set.types().filter(|it| packages.is_generated(&it.name));
    for message in types {
        let name = &message.name;
        let kinds = modules.entry(name.package()).or_default();
        let module = kinds.entry(name.kind()).or_default();
        let rust = type_name(name);
        if !name.name().starts_with(|c: char| c.is_ascii_uppercase()) {
            return Err(Error::TypeName(name.clone()));
        }
        if let Some(first) = module.names.insert(rust.clone(), name) {
            let (first, second) = (first.clone(), name.clone());
            return Err(Error::TypeTwice {
                first,
                second,
                rust,
            });
        }
        let path = |name: &TypeName| path_of(name, packages, &quote!(super::super));
        let from_view = |name: &TypeName| path_of(name, packages, &quote!(super::super::super));
        let paths = Paths {
            of_type: &path,
            of_view: &from_view,
        };
        module.items.push(match Role::of(name, set) {
            Role::Service => item::service(name, &path),
            Role::Action => item::action(name, &path),
            Role::Message => {
                let size = size_bytes(name, set)?;
                if size > SIZE_MAX_BYTES {
                    return Err(Error::TooLarge(name.clone(), size));
                }
                let (package, kind) = (ident(name.package()), ident(name.kind().name()));
                let rust = item::rust_ident(name);
                visits.push(quote!(visitor.visit::<#package::#kind::#rust>();));
                let code = item::message(message, set, paths)?;
                let code = code.map_err(|wrong| wrong_value(message, &wrong, packages))?;
                module.views.extend(code.view);
                code.items
            }
        });
    }
    let modules = modules
        .into_iter()
        .map(|(name, kinds)| package(name, kinds));
    let modules = modules.collect::<Vec<_>>();
    let file = syn::parse2(quote! {
        #(#modules)*

        /// Calls the visitor for each message of this file, in the order of their names.
        #[allow(dead_code, unreachable_pub)]
        pub fn for_each_type<V: ::sm2_ros::TypeVisitor>(visitor: &mut V) {
            #(#visits)*
        }
    })
    .map_err(Error::Code)?;
    Ok(prettyplease::unparse(&file))
}

/// The module of a package.
fn package(package: &str, kinds: BTreeMap<Kind, Module<'_>>) -> TokenStream {
    let kinds = kinds.into_iter().map(|(kind, module)| {
        let (ident, items) = (ident(kind.name()), module.items);
        let views = (!module.views.is_empty()).then(|| views(&module.views));
        let doc = format!(" The types of `{package}/{}`.", kind.name());
        quote! {
            #[doc = #doc]
            pub mod #ident {
                #(#items)*
                #views
            }
        }
    });
    let (ident, doc) = (ident(package), format!(" The package `{package}`."));
    // A program uses a part of the types, and its module of them may be private.
    quote! {
        #[doc = #doc]
        #[allow(dead_code, unreachable_pub)]
        pub mod #ident { #(#kinds)* }
    }
}

/// The module of the views.
fn views(structures: &[TokenStream]) -> TokenStream {
    quote! {
        /// The views of these types: see [`Viewed`](::sm2_ros::Viewed).
        pub mod view { #(#structures)* }
    }
}

/// The path of a type from a module of the generated file, where `supers` is the root of the file.
fn path_of(name: &TypeName, packages: &Packages, supers: &TokenStream) -> TokenStream {
    let (package, kind) = (ident(name.package()), ident(name.kind().name()));
    let rust = item::rust_ident(name);
    match packages.external(name) {
        Some(root) => quote!(#root::#package::#kind::#rust),
        None => quote!(#supers::#package::#kind::#rust),
    }
}

fn wrong_value(message: &Message, wrong: &WrongValue<'_>, packages: &Packages) -> Error {
    Error::Value {
        place: packages.find_line(&message.name, wrong.member, wrong.value),
        name: format!("{}.{}", message.name, wrong.member),
        ty: wrong.ty.clone(),
        value: wrong.value.to_owned(),
    }
}
