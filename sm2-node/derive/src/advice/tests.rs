use syn::parse_quote;

use super::*;
use crate::message;

/// The text of the error that the derive reports for a type.
fn error(input: &DeriveInput, has_zerocopy: bool) -> Option<String> {
    let text = message::expand(input, has_zerocopy).unwrap().to_string();
    let (_, rest) = text.split_once("compile_error ! { \"")?;
    let (message, _) = rest.split_once("\" }")?;
    Some(message.replace("\\\"", "\"").replace("\\n", "\n"))
}

#[test]
fn a_type_without_an_encoding_is_told_both_ways() {
    let input = parse_quote! {
        #[message(name = "nav/Path")]
        struct Path {
            points: Vec<(f64, f64)>,
        }
    };
    let expected = "`Path` has neither an encoding nor a `repr`
for a type that serde encodes, write: #[message(name = \"nav/Path\", encoding = \"postcard\")]
for plain old data, write: #[repr(C)] and #[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]";
    assert_eq!(error(&input, true).as_deref(), Some(expected));
}

#[test]
fn a_type_with_an_encoding_needs_no_zerocopy() {
    let input = parse_quote! {
        #[message(name = "nav/Path", encoding = "postcard")]
        struct Path {
            points: Vec<(f64, f64)>,
        }
    };
    assert_eq!(error(&input, false), None);
}

#[test]
fn a_missing_zerocopy_is_named() {
    let input = parse_quote! {
        #[message(name = "sensor/Imu")]
        #[repr(C)]
        struct Imu {
            stamp_ns: u64,
        }
    };
    assert_eq!(error(&input, true), None);
    let expected =
        "the derives of zerocopy need the crate `zerocopy`, which Cargo.toml does not name
write in Cargo.toml: zerocopy = { version = \"0.8\", features = [\"derive\"] }
or write at the type: #[zerocopy(crate = \"sm2_node::zerocopy\")]";
    assert_eq!(error(&input, false).as_deref(), Some(expected));
    let input = parse_quote! {
        #[message(name = "sensor/Imu")]
        #[zerocopy(crate = "sm2_node::zerocopy")]
        #[repr(C)]
        struct Imu {
            stamp_ns: u64,
        }
    };
    assert_eq!(error(&input, false), None);
}

#[test]
fn crates_are_found_in_a_manifest_as_whole_words() {
    for manifest in [
        "zerocopy = \"0.8\"",
        "zerocopy.workspace = true",
        "zc = { package = \"zerocopy\" }",
        "[dependencies.zerocopy]",
    ] {
        assert!(names_crate(manifest, "zerocopy"), "{manifest}");
    }
    for manifest in [
        "zerocopy-derive = \"0.8\"",
        "zerocopy_derive = \"0.8\"",
        "zerocopy2",
        "",
    ] {
        assert!(!names_crate(manifest, "zerocopy"), "{manifest}");
    }
    // The manifest of this crate, whose folder cargo tells its tests.
    assert!(manifest_names("proc-macro2"));
    assert!(!manifest_names("zero-copy"));
}

#[test]
fn padding_behind_a_list_is_explained() {
    let input = parse_quote! {
        #[message(name = "sensor/Image")]
        #[repr(C)]
        struct Image {
            width: U32,
            stamp_ns: u64,
            pixels: [u8],
        }
    };
    let expected = "`stamp_ns` has an alignment of 8 bytes and the elements of `pixels` have 1, \
                    so the message would end in padding bytes\n\
                    write `sm2_node::zerocopy::little_endian::U64` instead of `u64`, \
                    or #[repr(C, packed)] at the type";
    assert_eq!(error(&input, true).as_deref(), Some(expected));
}

#[test]
fn a_list_without_padding_compiles() {
    for input in [
        parse_quote! {
            #[message(name = "sensor/Scan")]
            #[repr(C)]
            struct Scan {
                origin: [f32; 2],
                ranges: [f32],
            }
        },
        parse_quote! {
            #[message(name = "sensor/Scan")]
            #[repr(C, packed(1))]
            struct Scan {
                stamp_ns: u64,
                ranges: [u8],
            }
        },
    ] {
        assert_eq!(error(&input, true), None);
    }
}

#[test]
fn each_number_has_its_alignment() {
    for (alignment, numbers) in [
        (2, &["u16", "i16"][..]),
        (4, &["u32", "i32", "f32"]),
        (8, &["u64", "i64", "f64"]),
        (16, &["u128", "i128"]),
    ] {
        for number in numbers {
            let ty: Type = syn::parse_str(number).unwrap();
            for (field, list) in [
                (quote!(#ty), quote!(u8)),
                (quote!([#ty; 2]), quote!(i8)),
                (quote!([[#ty; 2]; 2]), quote!([u8; 3])),
            ] {
                let input = parse_quote! {
                    #[message(name = "a/T")]
                    #[repr(C)]
                    struct T { a: #field, list: [#list] }
                };
                let error = error(&input, true).unwrap();
                let expected = format!("`a` has an alignment of {alignment} bytes");
                assert!(error.starts_with(&expected), "{number}: {error}");
            }
            // Before elements with the same alignment, there is no padding.
            let input = parse_quote! {
                #[message(name = "a/T")]
                #[repr(C)]
                struct T { a: #ty, list: [#ty] }
            };
            assert_eq!(error(&input, true), None, "{number}");
        }
    }
}

/// The derive knows the layout of C alone, and its own numbers.
#[test]
fn types_of_unknown_layout_are_left_to_the_compiler() {
    for input in [
        parse_quote! {
            #[message(name = "a/T")]
            #[repr(transparent)]
            struct T { a: u64, list: [u8] }
        },
        parse_quote! {
            #[message(name = "a/T")]
            #[repr(C, align(8))]
            struct T { a: other::Number, list: [u8] }
        },
        parse_quote! {
            #[message(name = "a/T")]
            #[repr(C)]
            struct T { a: u64, list: [Other] }
        },
    ] {
        assert_eq!(error(&input, true), None);
    }
    let input = parse_quote! {
        #[message(name = "a/T")]
        #[repr(align(8), C)]
        struct T { a: u64, list: [u8] }
    };
    assert!(error(&input, true).is_some());
}

/// Otherwise rustc would report each use of the type, too.
#[test]
fn a_type_with_an_error_is_a_message_all_the_same() {
    let input = parse_quote! {
        #[message(name = "nav/Path")]
        struct Path<T> where T: Copy { points: Vec<T> }
    };
    let text = message::expand(&input, true).unwrap().to_string();
    assert!(
        text.contains("impl < T > :: sm2_node :: Message for Path < T >"),
        "{text}"
    );
    assert!(
        text.contains("const NAME : & 'static str = \"nav/Path\""),
        "{text}"
    );
}
