//! `#[kani::proof]`, which keeps a harness in the library, and `#[kani::unwind]`, which does nothing.

use proc_macro::{TokenStream, TokenTree};

/// Keeps the function although no code calls it: the engine finds it by its symbol.
#[proc_macro_attribute]
pub fn proof(_: TokenStream, function: TokenStream) -> TokenStream {
    let mut words = function.clone().into_iter();
    words
        .by_ref()
        .find(|word| word.to_string() == "fn")
        .expect("a harness is a function");
    let Some(TokenTree::Ident(name)) = words.next() else {
        panic!("a function has a name");
    };
    let kept = format!("const _: () = {{ #[used] static HARNESS: fn() = {name}; }};");
    let mut harness: TokenStream = "#[inline(never)]".parse().expect("an attribute");
    harness.extend(function);
    harness.extend(kept.parse::<TokenStream>().expect("an item"));
    harness
}

/// A bound for Kani's loops: paths are explored here until they end.
#[proc_macro_attribute]
pub fn unwind(_: TokenStream, function: TokenStream) -> TokenStream {
    function
}
