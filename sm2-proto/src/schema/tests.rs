use alloc::{
    boxed::Box,
    format,
    string::{String, ToString},
    vec,
    vec::Vec,
};

use proptest::{collection, prelude::*, sample::select};

use super::*;
use crate::limits::{MESSAGE_MAX, SCHEMA_DEPTH_MAX, SCHEMA_TEXT_MAX};

mod definitions;

/// The line between two definitions of ROS 2.
const SEPARATOR: &str =
    "================================================================================";
const IMU: &str = "plain:struct{stamp_ns:u64,acceleration:array[f64;0000000000000003],}";
const PATH: &str = "postcard:struct{frame:string,points:list[struct{0:f64,1:f64,}],\
    mode:enum{Idle:struct{},Follow:struct{type:u8,},Go:struct{0:struct{0:f64,1:f64,},},},\
    labels:map[string,option[u8]],}";

fn parsed(text: &str) -> Schema {
    Schema::parse(text).unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn ty(schema: &Schema) -> &Type {
    match schema.root() {
        Root::Type(ty) => ty,
        Root::Definition(_) => panic!("{schema}"),
    }
}

fn wrong(text: &str) -> (usize, Reason) {
    match Schema::parse(text) {
        Ok(schema) => panic!("{text:?} was read as {schema:?}"),
        Err(ParseError { at, reason }) => (at, reason),
    }
}

#[test]
fn a_variant_shows_its_fields() {
    let schema = parsed("postcard:enum{Idle:struct{},Go:struct{fast:bool,},}");
    let Type::Enum(variants) = ty(&schema) else {
        panic!("an enumeration");
    };
    let names = |it: &Variant| it.fields().iter().map(|it| it.name().to_string()).collect();
    let fields: vec::Vec<vec::Vec<String>> = variants.iter().map(names).collect();
    assert_eq!(fields, [vec![], vec!["fast".to_string()]]);
}

//= SM2-TYP-001 test
#[test]
fn a_text_and_its_tree_are_the_same() {
    for text in [IMU, PATH, "json:enum{}", "cdr_2-le:set[char]", "plain:u8"] {
        assert_eq!(parsed(text).to_string(), text);
    }
    let imu = parsed(IMU);
    assert_eq!(imu.encoding(), &Encoding::Plain);
    let Type::Struct(fields) = ty(&imu) else {
        panic!("{imu:?}");
    };
    assert_eq!(fields[0].name(), "stamp_ns");
    assert_eq!(fields[0].ty(), &Type::Scalar(Scalar::U64));
    assert_eq!(fields[1].ty().to_string(), "array[f64;0000000000000003]");
}

/// The hashes that the tests of `sm2-node` expect for these types.
//= SM2-NAM-003 test
#[test]
fn the_hash_follows_from_the_text() {
    let golden = [
        (IMU, 0x01d4_8e4b_179e_db4c),
        (PATH, 0x5f2d_bc11_1d07_b51f),
        ("plain:f64", 0x4500_6ed6_bb55_2769),
        ("plain:list[f32]", 0x38b4_5b57_8157_b044),
        ("plain:struct{}", 0x9945_91ea_8828_e7a7),
        ("plain:string", 0xeb80_3ec8_3498_ec4b),
    ];
    for (text, hash) in golden {
        assert_eq!(parsed(text).hash(), hash, "{text}");
    }
}

//= SM2-TYP-001 test
#[test]
fn anything_else_is_refused_and_the_place_named() {
    use Reason::*;
    let cases = [
        ("", 0, Encoding),
        (":u8", 0, Encoding),
        ("Plain:u8", 0, Encoding),
        ("plain", 5, Expected(':')),
        ("plain:", 6, Type),
        ("plain: u8", 6, Type),
        ("plain:u9", 6, Type),
        ("plain:u8 ", 8, End),
        ("plain:u8,", 8, End),
        ("plain:struct", 12, Expected('{')),
        ("plain:struct{a:u8}", 17, Expected(',')),
        ("plain:struct{a:u8,", 18, Name),
        ("plain:struct{:u8,}", 13, Name),
        ("plain:struct{a b:u8,}", 14, Expected(':')),
        ("plain:struct{a:u8,a:u8,}", 18, NameTwice),
        ("plain:struct{\u{9b}:u8,}", 13, Name),
        ("plain:enum{A:u8,}", 13, Expected('s')),
        ("plain:enum{A:struct{},A:struct{},}", 22, NameTwice),
        ("plain:array[u8;3]", 15, Length),
        ("plain:array[u8;000000000000000A]", 15, Length),
        ("plain:array[u8;00000000000000003]", 15, Length),
        ("plain:array[u8]", 14, Expected(';')),
        ("plain:list[u8", 13, Expected(']')),
        ("plain:map[u8]", 12, Expected(',')),
        ("plain:map[u8, u8]", 13, Type),
    ];
    for (text, at, reason) in cases {
        assert_eq!(wrong(text), (at, reason), "{text}");
    }
    let long_name = "e".repeat(33) + ":u8";
    assert_eq!(wrong(&long_name), (0, Encoding));
    assert_eq!(parsed(&long_name[1..]).to_string(), long_name[1..]);
}

//= SM2-TYP-001 test
#[test]
fn depth_and_length_have_their_limits() {
    let nested = |depth: usize| format!("plain:{}u8{}", "list[".repeat(depth), "]".repeat(depth));
    let deepest = nested(SCHEMA_DEPTH_MAX);
    assert_eq!(parsed(&deepest).to_string(), deepest);
    assert_eq!(wrong(&nested(SCHEMA_DEPTH_MAX + 1)).1, Reason::TooDeep);
    assert_eq!(wrong(&nested(5_000)).1, Reason::TooDeep);
    let named = |len: usize| format!("plain:struct{{{}:u8,}}", "x".repeat(len - 18));
    let longest = named(SCHEMA_TEXT_MAX);
    assert_eq!(longest.len(), SCHEMA_TEXT_MAX);
    assert_eq!(parsed(&longest).to_string(), longest);
    assert_eq!(wrong(&named(SCHEMA_TEXT_MAX + 1)), (0, Reason::TooLong));
    // Brackets that were closed do not count.
    let wide: String = (0..2_000).map(|it| format!("f{it}:list[u8],")).collect();
    parsed(&format!("plain:struct{{{wide}}}"));
}

fn layout(text: &str) -> Result<Layout, NoLayout> {
    Layout::of(ty(&parsed(&format!("plain:{text}"))))
}

#[test]
fn plain_values_lie_one_behind_the_other() {
    let fixed = |fixed_bytes| {
        Ok(Layout {
            fixed_bytes,
            element_bytes: None,
        })
    };
    assert_eq!(layout("struct{a:u8,b:f64,c:char,d:bool,}"), fixed(14));
    assert_eq!(
        layout("array[struct{a:u16,b:i128,};0000000000000003]"),
        fixed(54)
    );
    assert_eq!(layout("array[struct{};ffffffffffffffff]"), fixed(0));
    let image =
        layout("struct{width:u32,rows:struct{h:u8,pixels:list[array[u8;0000000000000003]],},}");
    let image = image.unwrap();
    assert_eq!((image.fixed_bytes, image.element_bytes), (5, Some(3)));
    let elements = [4, 5, 6, 8, 11].map(|bytes| image.elements(bytes));
    assert_eq!(elements, [None, Some(0), None, Some(1), Some(2)]);
    assert_eq!(layout("u64").unwrap().elements(8), Some(0));
    assert_eq!(layout("u64").unwrap().elements(9), None);
}

#[test]
fn encodings_by_their_names() {
    let encoding = |text: &str| parsed(text).encoding;
    assert_eq!(encoding("plain:u8"), Encoding::Plain);
    assert_eq!(encoding("postcard:u8"), Encoding::Postcard);
    assert_eq!(encoding("json:u8"), Encoding::Json);
    assert_eq!(encoding("xcdr:u8"), Encoding::Other("xcdr".into()));
}

/// Brackets beside each other are not inside each other.
//= SM2-TYP-001 test
#[test]
fn width_is_not_depth() {
    let fields = (0..2 * SCHEMA_DEPTH_MAX).map(|field| format!("f{field}:list[u8],"));
    let text = format!("plain:struct{{{}}}", fields.collect::<String>());
    assert_eq!(parsed(&text).to_string(), text);
}

#[test]
fn names_of_fields_and_variants() {
    for text in ["a", "Z", "0", "_", "-", "a_9-Z", "größe", "\u{a0}", "名"] {
        assert!(is_name(text), "{text}");
    }
    for text in [
        "", " ", "a b", "a.b", "a/b", "a:", "{", "\u{7f}", "\u{9f}", "a\n",
    ] {
        assert!(!is_name(text), "{text:?}");
    }
    // Both readings of the rule: that of whole names, and the parser's.
    for c in ('\0'..'\u{800}').chain(['名', '\u{10ffff}']) {
        let read = Schema::parse(&format!("plain:struct{{{c}:u8,}}")).is_ok();
        assert_eq!(is_name(&c.to_string()), read, "{c:?}");
    }
}

#[test]
fn what_has_no_plain_layout_says_why() {
    let cases = [
        ("string", NoLayout::Kind),
        ("struct{a:option[u8],}", NoLayout::Kind),
        ("struct{a:list[u8],b:u8,}", NoLayout::ListNotLast),
        ("struct{a:list[u8],b:list[u8],}", NoLayout::ListNotLast),
        ("list[list[u8]]", NoLayout::ListNotLast),
        ("array[list[u8];0000000000000000]", NoLayout::ListNotLast),
        ("list[struct{}]", NoLayout::EmptyElement),
        ("array[u8;ffffffffffffffff]", NoLayout::TooLong),
        (
            "array[array[u64;8000000000000000];0000000000000002]",
            NoLayout::TooLong,
        ),
        (
            "struct{a:array[u8;000000ffffffffff],b:u16,}",
            NoLayout::TooLong,
        ),
    ];
    for (text, expected) in cases {
        assert_eq!(layout(text), Err(expected), "{text}");
    }
    let whole = layout("struct{a:array[u8;000000ffffffffff],b:u8,}").unwrap();
    assert_eq!(whole.fixed_bytes, MESSAGE_MAX, "not one byte too many");
    let longest = layout("array[u8;0000010000000000]").unwrap();
    assert_eq!(longest.fixed_bytes, MESSAGE_MAX);
}

fn names() -> impl Strategy<Value = String> {
    "[a-zA-Z0-9_ü界-]{1,6}"
}

fn fields(ty: impl Strategy<Value = Type>) -> impl Strategy<Value = Vec<Field>> {
    collection::btree_map(names(), ty, 0..4).prop_map(|fields| {
        let field = |(name, ty): (String, Type)| Field {
            name: name.into(),
            ty,
        };
        fields.into_iter().map(field).collect()
    })
}

fn types() -> impl Strategy<Value = Type> {
    let leaf = prop_oneof![select(Scalar::ALL).prop_map(Type::Scalar), Just(Type::Text),];
    leaf.prop_recursive(6, 60, 4, |inner| {
        let boxed = || inner.clone().prop_map(Box::new);
        let variants = collection::btree_map(names(), fields(inner.clone()), 0..4);
        prop_oneof![
            fields(inner.clone()).prop_map(Type::Struct),
            variants.prop_map(|it| {
                let variant = |(name, fields): (String, Vec<Field>)| Variant {
                    name: name.into(),
                    fields,
                };
                Type::Enum(it.into_iter().map(variant).collect())
            }),
            (boxed(), any::<u64>()).prop_map(|(element, len)| Type::Array { element, len }),
            boxed().prop_map(Type::List),
            boxed().prop_map(Type::Set),
            boxed().prop_map(Type::Option),
            (boxed(), boxed()).prop_map(|(key, value)| Type::Map { key, value }),
        ]
    })
}

fn schemas() -> impl Strategy<Value = Schema> {
    let encodings = select(vec!["plain", "postcard", "json", "other-1"]);
    let encodings = encodings.prop_map(Encoding::named);
    let trees = (encodings, types().prop_map(Root::Type));
    let lines = prop_oneof![Just(SEPARATOR.into()), "[ -~\u{a0}-\u{ffff}]{1,12}"];
    let definitions = (any::<[u8; 32]>(), collection::vec(lines, 0..6));
    let definitions = definitions.prop_map(|(rihs01, lines)| {
        let text = lines.iter().map(|line| format!("{line}\n"));
        let text = text.collect::<String>().into();
        let root = Root::Definition(Definition { rihs01, text });
        (Encoding::Cdr, root)
    });
    let schemas = prop_oneof![4 => trees, 1 => definitions];
    schemas.prop_map(|(encoding, root)| Schema { encoding, root })
}

/// The hash by the rule of SPEC Annex A: each part of the text becomes its hash, the
/// innermost first.
fn hash_of_text(text: &str) -> u64 {
    if text.starts_with("cdr:") {
        return hash::text(text.lines().next().unwrap());
    }
    let (encoding, mut rest) = text.split_once(':').unwrap();
    let part = format!("{:016x}", hash_of_part(&mut rest));
    assert_eq!(rest, "");
    hash::text(&format!("{encoding}:{part}"))
}

fn hash_of_part(rest: &mut &str) -> u64 {
    let end = rest
        .find(['{', '[', ']', '}', ',', ';'])
        .unwrap_or(rest.len());
    let mut own = String::from(&rest[..end]);
    *rest = &rest[end..];
    if rest.starts_with(['{', '[']) {
        let names = rest.starts_with('{');
        let mut depth_zero = false;
        while !depth_zero {
            own.push_str(&rest[..1]);
            *rest = &rest[1..];
            if rest.starts_with(['}', ']']) {
                depth_zero = true;
            } else if own.ends_with(';') {
                own.push_str(&rest[..16]);
                *rest = &rest[16..];
                depth_zero = true;
            } else {
                if names {
                    let colon = rest.find(':').unwrap() + 1;
                    own.push_str(&rest[..colon]);
                    *rest = &rest[colon..];
                }
                own.push_str(&format!("{:016x}", hash_of_part(rest)));
                depth_zero = rest.starts_with(['}', ']']);
            }
        }
        own.push_str(&rest[..1]);
        *rest = &rest[1..];
    }
    hash::text(&own)
}

proptest! {
    //= SM2-TYP-001, SM2-TYP-002 test
    #[test]
    fn any_tree_is_read_from_its_text(schema in schemas()) {
        let text = schema.to_string();
        prop_assert_eq!(Schema::parse(&text), Ok(schema.clone()));
        prop_assert_eq!(schema.hash(), hash_of_text(&text));
        // Any text is read without a panic.
        if let Root::Type(ty) = schema.root() {
            let _ = Layout::of(ty);
        }
    }

    //= SM2-TYP-001, SM2-TYP-002 test
    #[test]
    fn no_text_makes_it_panic(text in ".{0,60}", schema in schemas(), at in any::<u16>()) {
        let _ = Schema::parse(&text);
        let _ = Schema::parse(&format!("plain:{text}"));
        let _ = Schema::parse(&format!("cdr:{text}"));
        // Texts that are nearly legal are not read as another schema.
        let mut near: Vec<char> = schema.to_string().chars().collect();
        let at = usize::from(at) % near.len();
        near[at] = text.chars().next().unwrap_or('{');
        let near: String = near.into_iter().collect();
        if let Ok(schema) = Schema::parse(&near) {
            prop_assert_eq!(schema.to_string(), near);
        }
    }
}
