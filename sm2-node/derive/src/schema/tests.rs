use syn::parse_quote;

use super::*;

/// The names of the fields and variants in the hash, in its order: those of an enum's variants come before their
/// fields.
fn names(input: &DeriveInput) -> Vec<String> {
    let text = expand(input).unwrap().to_string();
    let (hash, _) = text.split_once("fn describe").unwrap();
    let (_, hash) = hash.split_once("const HASH").unwrap();
    let quoted = hash.split('"').skip(1).step_by(2);
    quoted.map(str::to_owned).collect()
}

/// The error about a type.
fn error(input: &DeriveInput) -> String {
    expand(input).unwrap_err().to_string()
}

/// The rules and the words of serde's own tests.
#[test]
fn the_rules_of_renaming_are_those_of_serde() {
    for (rule, variants, fields) in [
        (
            "lowercase",
            ["outcome", "verytasty", "a", "z42"],
            ["outcome", "very_tasty", "a", "z42"],
        ),
        (
            "UPPERCASE",
            ["OUTCOME", "VERYTASTY", "A", "Z42"],
            ["OUTCOME", "VERY_TASTY", "A", "Z42"],
        ),
        (
            "PascalCase",
            ["Outcome", "VeryTasty", "A", "Z42"],
            ["Outcome", "VeryTasty", "A", "Z42"],
        ),
        (
            "camelCase",
            ["outcome", "veryTasty", "a", "z42"],
            ["outcome", "veryTasty", "a", "z42"],
        ),
        (
            "snake_case",
            ["outcome", "very_tasty", "a", "z42"],
            ["outcome", "very_tasty", "a", "z42"],
        ),
        (
            "SCREAMING_SNAKE_CASE",
            ["OUTCOME", "VERY_TASTY", "A", "Z42"],
            ["OUTCOME", "VERY_TASTY", "A", "Z42"],
        ),
        (
            "kebab-case",
            ["outcome", "very-tasty", "a", "z42"],
            ["outcome", "very-tasty", "a", "z42"],
        ),
        (
            "SCREAMING-KEBAB-CASE",
            ["OUTCOME", "VERY-TASTY", "A", "Z42"],
            ["OUTCOME", "VERY-TASTY", "A", "Z42"],
        ),
    ] {
        let of_variants = parse_quote! {
            #[serde(rename_all = #rule)]
            enum E { Outcome, VeryTasty, A, Z42 }
        };
        assert_eq!(names(&of_variants), variants, "{rule}");
        let of_fields = parse_quote! {
            #[serde(rename_all = #rule)]
            struct S { outcome: u8, very_tasty: u8, a: u8, z42: u8 }
        };
        assert_eq!(names(&of_fields), fields, "{rule}");
        let of_fields_of_variants = parse_quote! {
            #[serde(rename_all_fields = #rule)]
            enum E { V { outcome: u8, very_tasty: u8, a: u8, z42: u8 } }
        };
        let expected = [&["V"], &fields[..]].concat();
        assert_eq!(names(&of_fields_of_variants), expected, "{rule}");
    }
    let unknown = parse_quote! {
        #[serde(rename_all = "dot.case")]
        struct S { a: u8 }
    };
    assert!(error(&unknown).contains("unknown rule"));
}

#[test]
fn a_name_of_its_own_precedes_the_rule() {
    let input = parse_quote! {
        #[serde(rename_all = "UPPERCASE", rename_all_fields = "UPPERCASE")]
        enum E {
            #[serde(rename = "first")]
            One { a: u8, #[serde(rename = "bb")] b: u8 },
            #[serde(rename_all = "PascalCase")]
            Two { a_b: u8 },
            Three(u8, u16),
        }
    };
    assert_eq!(
        names(&input),
        ["first", "A", "bb", "TWO", "AB", "THREE", "0", "1"]
    );
    let input = parse_quote! {
        struct S { r#type: u8, plain: u8 }
    };
    assert_eq!(names(&input), ["type", "plain"]);
}

#[test]
fn two_equal_names_are_refused() {
    for input in [
        parse_quote! {
            struct S { #[serde(rename = "b")] a: u8, b: u8 }
        },
        parse_quote! {
            enum E { #[serde(rename = "b")] A, b }
        },
        parse_quote! {
            enum E { V { #[serde(rename = "b")] a: u8, b: u8 } }
        },
    ] {
        assert_eq!(error(&input), "the name \"b\" is used twice");
    }
    // Fields of two variants, or a variant and its field, may have one name.
    let input = parse_quote! {
        enum E { a { a: u8 }, b { a: u8 } }
    };
    assert_eq!(names(&input), ["a", "a", "b", "a"]);
}

#[test]
fn attributes_that_change_the_encoding_are_refused_everywhere() {
    let changes = "content deserialize_with flatten from into remote serialize_with skip skip_deserializing \
                   skip_serializing skip_serializing_if tag try_from untagged with";
    for change in changes.split_whitespace() {
        let change = quote::format_ident!("{change}");
        for input in [
            parse_quote! {
                #[serde(#change)]
                struct S { a: u8 }
            },
            parse_quote! {
                struct S { #[serde(#change)] a: u8 }
            },
            parse_quote! {
                enum E { #[serde(#change)] A }
            },
            parse_quote! {
                enum E { A(#[serde(#change)] u8) }
            },
            parse_quote! {
                #[serde(transparent)]
                struct S(#[serde(#change)] u8);
            },
        ] {
            let error = error(&input);
            assert!(
                error.starts_with(&format!("`{change}` changes the encoding")),
                "{error}"
            );
        }
    }
    // Two names, one for each direction, have no common hash.
    let input = parse_quote! {
        struct S { #[serde(rename(serialize = "x", deserialize = "y"))] a: u8 }
    };
    assert!(error(&input).contains("one name for both directions"));
}

#[test]
fn other_attributes_of_serde_are_allowed_with_their_values() {
    let plain = parse_quote! {
        struct S { a: u8, b: u8 }
    };
    let input = parse_quote! {
        #[serde(default, crate = "sm2_node::serde", bound(serialize = "T: A", deserialize = "T: B"))]
        #[serde(deny_unknown_fields)]
        #[other(skip)]
        struct S {
            #[serde(default = "of_a", alias = "other")]
            a: u8,
            #[serde(default, rename = "b")]
            b: u8,
        }
    };
    assert_eq!(
        expand(&input).unwrap().to_string(),
        expand(&plain).unwrap().to_string()
    );
}

#[test]
fn a_transparent_type_is_its_only_field() {
    let input = parse_quote! {
        #[serde(transparent)]
        struct S { inner: Inner }
    };
    assert!(names(&input).is_empty());
    let text = expand(&input).unwrap().to_string();
    assert!(
        text.contains("< Inner as :: sm2_node :: Schema > :: HASH ;"),
        "{text}"
    );
    assert!(
        text.contains("< Inner as :: sm2_node :: Schema > :: describe (text)"),
        "{text}"
    );
    for fields in [quote!(), quote!(a: u8, b: u8)] {
        let input = parse_quote! {
            #[serde(transparent)]
            struct S { #fields }
        };
        assert!(error(&input).contains("that of its only field"));
    }
}

#[test]
fn a_union_has_no_schema() {
    let input = parse_quote! {
        union U { a: u32, b: f32 }
    };
    assert!(error(&input).starts_with("a union has no schema"));
}

/// The bounds are those of the fields, so a parameter that is not in a field needs no schema.
#[test]
fn a_generic_type_has_a_schema_if_its_fields_have_one() {
    for (input, bounds) in [
        (
            parse_quote! {
                struct S<T> where T: Copy { a: Vec<T>, b: u8 }
            },
            "where T : Copy , Vec < T > : :: sm2_node :: Schema , u8 : :: sm2_node :: Schema",
        ),
        (
            parse_quote! {
                enum E<T> { A(T), B { b: u8 } }
            },
            "where T : :: sm2_node :: Schema , u8 : :: sm2_node :: Schema",
        ),
        (
            parse_quote! {
                struct S<const N: usize> { a: [u8; N] }
            },
            "for S < N > {",
        ),
    ] {
        let text = expand(&input).unwrap().to_string();
        assert!(text.contains(bounds), "{bounds} in {text}");
        assert_eq!(text.contains("where"), bounds.contains("where"), "{text}");
    }
}
