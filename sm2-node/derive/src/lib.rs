//! The derive macros `#[derive(Message)]` and `#[derive(Schema)]` of `sm2_node`, which re-exports and
//! documents them.

mod advice;
mod message;
mod schema;
mod serde;

use proc_macro::TokenStream;
use syn::{DeriveInput, parse_macro_input};

/// Derives `sm2_node::Message` and `sm2_node::Schema`.
///
/// ```text
/// #[message(name = "sensor/Imu")]                       // plain old data, read in place
/// #[message(name = "nav/Path", encoding = "postcard")]  // any serde type
/// #[message(name = "nav/Goal", encoding = "json")]      // the same, with sm2-node's feature `json`
/// ```
#[proc_macro_derive(Message, attributes(message))]
pub fn derive_message(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    message::expand(&input, advice::manifest_names("zerocopy"))
        .unwrap_or_else(|error| error.to_compile_error())
        .into()
}

/// Derives `sm2_node::Schema` for a type that is a part of messages.
#[proc_macro_derive(Schema)]
pub fn derive_schema(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    schema::expand(&input)
        .unwrap_or_else(|error| error.to_compile_error())
        .into()
}
