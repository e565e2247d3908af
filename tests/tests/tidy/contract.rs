//! The contract of the link machine, whose page lists all methods that change the machine beside `handle`.

use std::{collections::BTreeSet, path::Path};

use syn::{FnArg, ImplItem, Item, ReceiverKind, Type, Visibility};

/// Begins the list on the page.
const HEADING: &str = "# What changes the machine beside `handle`";
/// Ends it.
const END: &str = "//! Each of them";

/// The methods that the list of this page names, as ``[`Link::send`]``.
pub(crate) fn listed(page: &str) -> BTreeSet<String> {
    let (_, list) = page.split_once(HEADING).expect("the heading of the list");
    let (list, _) = list.split_once(END).expect("the end of the list");
    let names = list.split("[`Link::").skip(1);
    let names = names.filter_map(|it| it.split_once('`'));
    names.map(|(name, _)| name.to_owned()).collect()
}

/// The public methods of `Link` in this file that take `&mut self`.
pub(crate) fn changing(path: &Path, text: &str) -> BTreeSet<String> {
    let parsed = syn::parse_file(text);
    let parsed = parsed.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let blocks = parsed.items.iter().filter_map(|it| match it {
        Item::Impl(block) if block.trait_.is_none() && is_link(&block.self_ty) => Some(block),
        _ => None,
    });
    let methods = blocks.flat_map(|it| &it.items);
    let methods = methods.filter_map(|it| match it {
        ImplItem::Fn(method) if matches!(method.vis, Visibility::Public(_)) => Some(&method.sig),
        _ => None,
    });
    let changing = methods.filter(|it| match it.inputs.first() {
        Some(FnArg::Receiver(it)) => matches!(it.kind, ReceiverKind::Reference(_, _, Some(_))),
        _ => false,
    });
    changing.map(|it| it.ident.to_string()).collect()
}

fn is_link(name: &Type) -> bool {
    matches!(name, Type::Path(it) if it.path.is_ident("Link"))
}

#[test]
fn a_method_that_changes_a_link_is_found() {
    let text = "
        impl Link {
            pub fn send(&mut self) {}
            pub const fn harvest<R>(&mut self, each: R) {}
            pub fn has_room(&self) {}
            fn tick(&mut self) {}
            pub(super) fn finish(&mut self) {}
            pub fn new(config: Config) -> Self {}
        }
        impl Machine for Link { fn handle(&mut self) {} }
        impl Other { pub fn take(&mut self) {} }";
    let found = changing(Path::new("made up"), text);
    assert_eq!(Vec::from_iter(found), ["harvest", "send"]);
    let page = format!("{HEADING}\n//! | [`Link::send`], [`Link::x`] |\n{END} [`Link::y`]");
    assert_eq!(Vec::from_iter(listed(&page)), ["send", "x"]);
}
