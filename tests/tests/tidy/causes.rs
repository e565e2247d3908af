//! Error texts that show their own source, which programs would print twice.

use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};
use syn::{
    Attribute, Field, Fields, ItemStruct, Meta, Variant,
    visit::{self, Visit},
};

use super::sources::Finding;

/// Errors whose `#[error(...)]` shows the field that thiserror returns from `source()`.
pub(crate) fn shown_sources(path: &Path, text: &str) -> Vec<Finding> {
    if !text.contains("#[error(") {
        return Vec::new();
    }
    let parsed = syn::parse_file(text);
    let parsed = parsed.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut visitor = Errors {
        path,
        found: Vec::new(),
    };
    visitor.visit_file(&parsed);
    visitor.found
}

struct Errors<'a> {
    path: &'a Path,
    found: Vec<Finding>,
}

impl Errors<'_> {
    fn check(&mut self, attributes: &[Attribute], fields: &Fields, name: &syn::Ident) {
        let shown = attributes.iter().find_map(text_of);
        let Some((shown, (at, source))) = shown.zip(source_of(fields)) else {
            return;
        };
        let field = source.ident.as_ref();
        let field = field.map_or_else(|| at.to_string(), ToString::to_string);
        if !is_transparent(&shown) && shows(shown, &field) {
            self.found.push(Finding {
                file: self.path.to_owned(),
                line: name.span().start().line,
                text: format!("the text of {name} shows `{field}`, which is its source as well"),
            });
        }
    }
}

impl<'ast> Visit<'ast> for Errors<'_> {
    fn visit_variant(&mut self, it: &'ast Variant) {
        self.check(&it.attrs, &it.fields, &it.ident);
        visit::visit_variant(self, it);
    }

    fn visit_item_struct(&mut self, it: &'ast ItemStruct) {
        self.check(&it.attrs, &it.fields, &it.ident);
        visit::visit_item_struct(self, it);
    }
}

/// The tokens between the parentheses of `#[error(...)]`.
fn text_of(attribute: &Attribute) -> Option<TokenStream> {
    match &attribute.meta {
        Meta::List(list) if list.path.is_ident("error") => Some(list.tokens.clone()),
        _ => None,
    }
}

fn is_transparent(text: &TokenStream) -> bool {
    text.to_string() == "transparent"
}

/// The field that thiserror returns from `source()`, and its position. A field `r#source` is none.
fn source_of(fields: &Fields) -> Option<(usize, &Field)> {
    let marked = |it: &Attribute| {
        ["from", "source"]
            .iter()
            .any(|name| it.path().is_ident(name))
    };
    let by_mark = |(_, it): &(usize, &Field)| it.attrs.iter().any(marked);
    let by_name = |(_, it): &(usize, &Field)| it.ident.as_ref().is_some_and(|it| it == "source");
    let numbered = || fields.iter().enumerate();
    numbered()
        .find(by_mark)
        .or_else(|| numbered().find(by_name))
}

/// True if a format string or an argument names the field.
fn shows(text: TokenStream, field: &str) -> bool {
    text.into_iter().any(|token| match token {
        TokenTree::Group(group) => shows(group.stream(), field),
        TokenTree::Ident(ident) => ident == field,
        // A format string, or the number in an argument such as `.0`.
        TokenTree::Literal(literal) => {
            let literal = literal.to_string();
            let in_braces = |end| literal.contains(&format!("{{{field}{end}"));
            literal == field || in_braces('}') || in_braces(':')
        }
        TokenTree::Punct(_) => false,
    })
}
