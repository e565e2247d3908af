use super::*;

/// The code for a type with these options.
fn code(options: &TokenStream) -> Result<String> {
    let input = parse_quote! {
        #[message(#options)]
        #[repr(C)]
        struct T { a: u8 }
    };
    expand(&input, true).map(|it| it.to_string())
}

#[test]
fn a_type_is_plain_or_has_the_functions_of_its_encoding() {
    for options in [
        quote!(name = "a/T"),
        quote!(name = "a/T", encoding = "plain"),
    ] {
        let code = code(&options).unwrap();
        assert!(code.contains(":: sm2_node :: Plain for T"), "{code}");
        assert!(!code.contains(":: encoding ::"), "{code}");
    }
    let code = code(&quote!(name = "a/T", encoding = "postcard")).unwrap();
    for part in [
        ":: sm2_node :: Message for T",
        "const NAME : & 'static str = \"a/T\"",
        "schema :: message (\"postcard\"",
        "message_text :: < Self > (\"postcard\")",
        "encoding :: to_postcard (self)",
        "encoding :: from_postcard (& payload)",
        ":: sm2_node :: Schema for T",
    ] {
        assert!(code.contains(part), "no {part} in {code}");
    }
}

#[test]
fn the_encoding_json_needs_its_feature() {
    let code = code(&quote!(name = "a/T", encoding = "json"));
    if cfg!(feature = "json") {
        let code = code.unwrap();
        assert!(code.contains("encoding :: to_json (self)"), "{code}");
    } else {
        let error = code.unwrap_err().to_string();
        assert!(error.contains("needs the feature `json`"), "{error}");
    }
}

#[test]
fn wrong_options_are_explained() {
    for (options, expected) in [
        (quote!(), "a message type needs a name"),
        (quote!(encoding = "postcard"), "a message type needs a name"),
        (
            quote!(name = "a/T", encoding = "cbor"),
            "unknown encoding: use \"plain\"",
        ),
        (
            quote!(name = "a/T", version = "1"),
            "unknown option: use `name` or `encoding`",
        ),
    ] {
        let error = code(&options).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{options}: {error}");
    }
    let input = parse_quote! {
        #[message(name = "a/T", encoding = "postcard")]
        struct T<'a> { a: &'a str }
    };
    let error = expand(&input, true).unwrap_err().to_string();
    assert!(error.starts_with("a message owns its data"), "{error}");
}

/// The compiler checks these bounds where a generic type is used, and not where it is defined.
#[test]
fn a_generic_type_is_a_message_if_its_parts_are() {
    let encoded = parse_quote! {
        #[message(name = "a/T", encoding = "postcard")]
        struct T<A> { a: A }
    };
    let plain = parse_quote! {
        #[message(name = "a/T")]
        #[repr(C)]
        struct T<A> { a: A }
    };
    for (input, bound) in [(encoded, "DeserializeOwned"), (plain, "KnownLayout")] {
        let code = expand(&input, true).unwrap().to_string();
        let bound = format!("{bound} + :: sm2_node :: Schema");
        assert!(code.contains(&bound), "no {bound} in {code}");
        assert!(code.contains("Self : :: core :: marker :: Send"), "{code}");
    }
    let simple = code(&quote!(name = "a/T", encoding = "postcard")).unwrap();
    assert!(!simple.contains("DeserializeOwned"), "{simple}");
}
