//! The bodies of the fuzz targets in `fuzz/` that read definitions of ROS 2 and messages in CDR.

use serde_json::{Value as Json, json};
use sm2_ros_idl::{Kind, Set, TypeName};

use crate::cdr::{from_slice, to_vec};
use crate::{DecodeError, Fault, TypeVisitor, Viewed, decode, encode, for_each_type, view};

/// The number of elements of a list that are kept in a second decoding.
const KEEP: usize = 3;

/// Definitions that services and actions refer to.
const DERIVED: [(&str, &str); 3] = [
    ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec"),
    (
        "service_msgs/msg/ServiceEventInfo",
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number",
    ),
    ("unique_identifier_msgs/msg/UUID", "uint8[16] uuid"),
];

/// Fuzzes definitions. The lower two bits of the first byte choose an `.action`, `.msg` or `.srv` text, or the text of
/// a type with all types that it refers to; the next bit chooses the longest name. The rest is the text.
///
/// A type has a text and a hash, or neither. The text parses to types with the same text and hash.
pub fn ros_definition(data: &[u8]) {
    let Some((&choice, text)) = data.split_first() else {
        return;
    };
    let Ok(text) = str::from_utf8(text) else {
        return;
    };
    let (kind, name) = chosen(choice);
    let parsed = match kind {
        None => Set::parse(&name, text),
        Some(_) => {
            let mut set = Set::default();
            for (name, text) in DERIVED {
                let name = name.parse().expect("a legal name");
                set.add(&name, text).expect("a legal definition");
            }
            set.add(&name, text).map(|()| set)
        }
    };
    match parsed {
        Ok(set) => set.types().for_each(|it| text_is_the_type(&set, &it.name)),
        // A caller prints the error.
        Err(error) => drop(error.to_string()),
    }
}

/// The kind of a definition, and its name.
fn chosen(choice: u8) -> (Option<Kind>, TypeName) {
    let own = match choice & 4 {
        0 => "T".to_owned(),
        _ => "T".repeat(120),
    };
    let kind = Kind::ALL.get(usize::from(choice & 3)).copied();
    let name = TypeName::new("p", kind.unwrap_or(Kind::Msg), &own).expect("a legal name");
    (kind, name)
}

fn text_is_the_type(set: &Set, name: &TypeName) {
    let Ok(text) = set.text(name) else {
        assert!(set.hash(name).is_err() && set.schema_text(name).is_err());
        return;
    };
    let again = Set::parse(name, &text).expect("a text that was written is legal");
    assert_eq!(again.text(name).as_ref(), Ok(&text));
    assert_eq!(again.hash(name), set.hash(name));
}

/// Fuzzes messages. If the first byte is 128 or more, it chooses a type of the common interfaces together with the next
/// one, and the rest is a message of this type. Otherwise the input is a definition, a byte 0, and a message or JSON.
pub fn ros_message(data: &[u8]) {
    match Input::of(data) {
        Input::Typed { number, payload } => for_each_type(&mut Chosen {
            left: number,
            payload,
        }),
        Input::Described { text, payload } => described(text, payload),
    }
}

#[derive(Debug, PartialEq)]
enum Input<'a> {
    /// The number of a type.
    Typed {
        number: usize,
        payload: &'a [u8],
    },
    Described {
        text: &'a str,
        payload: &'a [u8],
    },
}

impl<'a> Input<'a> {
    fn of(data: &'a [u8]) -> Self {
        if let [high @ 0x80..=0xff, low, payload @ ..] = data {
            let number = number_of(*high, *low, type_count());
            return Self::Typed { number, payload };
        }
        let mut parts = data.splitn(2, |&byte| byte == 0);
        let (text, payload) = (parts.next(), parts.next());
        let text = text.and_then(|it| str::from_utf8(it).ok());
        Self::Described {
            text: text.unwrap_or_default(),
            payload: payload.unwrap_or_default(),
        }
    }
}

/// The number of a type, of so many.
fn number_of(high: u8, low: u8, count: usize) -> usize {
    usize::from(u16::from_be_bytes([high & 0x7f, low])) % count
}

/// Visits one type.
struct Chosen<'a> {
    /// The number of types before it.
    left: usize,
    payload: &'a [u8],
}

impl TypeVisitor for Chosen<'_> {
    fn visit<T: Viewed>(&mut self) {
        match self.left.checked_sub(1) {
            Some(left) => self.left = left,
            None => {
                self.left = usize::MAX;
                typed::<T>(self.payload);
            }
        }
    }
}

fn type_count() -> usize {
    struct Count(usize);
    impl TypeVisitor for Count {
        fn visit<T: Viewed>(&mut self) {
            self.0 += 1;
        }
    }
    let mut count = Count(0);
    for_each_type(&mut count);
    count.0
}

/// Bytes are a message of a Rust type exactly if they are one of its definition, and both have the same values. So has
/// the view.
fn typed<T: Viewed>(payload: &[u8]) {
    let name = T::TYPE_NAME.parse().expect("a legal name");
    let (_, text) = T::SCHEMA.split_once('\n').expect("the line of the hash");
    let set = Set::parse(&name, text).expect("a legal definition");
    let json = message(&set, &name, payload);
    let typed = from_slice::<T>(payload);
    assert_eq!(typed.is_ok(), json.is_some(), "{name}: {typed:?}");
    let read = view::<T>(payload).map(|it| format!("{it:?}"));
    let shown = typed.as_ref().map(|it| format!("{it:?}"));
    assert_eq!(read.as_ref(), shown.as_ref().map_err(|it| *it), "{name}");
    let (Ok(typed), Some(json)) = (typed, json) else {
        return;
    };
    let bytes = to_vec(&typed).expect("the limits were checked");
    assert_eq!(message(&set, &name, &bytes), Some(json), "{name}");
    let again = from_slice::<T>(&bytes).expect("a message that was encoded");
    assert_eq!(to_vec(&again).as_ref(), Ok(&bytes), "{name}");
}

/// A message of a type whose definition comes with it, and JSON for one.
fn described(text: &str, payload: &[u8]) {
    let name = "p/msg/T".parse().expect("a legal name");
    let Ok(set) = Set::parse(&name, text) else {
        return;
    };
    message(&set, &name, payload);
    let given = serde_json::from_slice(payload).unwrap_or_else(|_| json!({}));
    if let Ok(bytes) = encode(&set, &name, &given) {
        // The values may be more than are kept.
        decode(&set, &name, &bytes, 0).expect("a message that was encoded");
    }
}

/// Decodes a message. Its JSON encodes to a message with the same JSON. The number of elements that are kept has no
/// effect on the result.
fn message(set: &Set, name: &TypeName, bytes: &[u8]) -> Option<Json> {
    let value = decode(set, name, bytes, usize::MAX);
    let short = decode(set, name, bytes, KEEP);
    let is_too_much = matches!(
        &value,
        Err(DecodeError::Value {
            fault: Fault::Values,
            ..
        })
    );
    assert!(is_too_much || value.is_ok() == short.is_ok(), "{short:?}");
    let json = serde_json::to_value(value.ok()?).expect("every message has its JSON");
    let again = encode(set, name, &json).expect("the JSON of a message");
    let value = decode(set, name, &again, usize::MAX);
    let value = value.expect("a message that was encoded");
    assert_eq!(
        serde_json::to_value(value).ok().as_ref(),
        Some(&json),
        "{name}"
    );
    Some(json)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_byte_of_a_definition_chooses_its_kind_and_its_name() {
        for choice in 0..=u8::MAX {
            let (kind, name) = chosen(choice);
            let expected = [Some(Kind::Action), Some(Kind::Msg), Some(Kind::Srv), None];
            assert_eq!(kind, expected[usize::from(choice) % 4], "{choice}");
            let len = if choice % 8 < 4 { 1 } else { 120 };
            assert_eq!(name.name().len(), len, "{choice}");
            assert_eq!(name.kind(), kind.unwrap_or(Kind::Msg), "{choice}");
        }
    }

    #[test]
    fn each_type_can_be_chosen() {
        // More types than one byte can number.
        let count = 300;
        let all =
            (0x80..=0xff).flat_map(|high| (0..=0xff).map(move |low| number_of(high, low, count)));
        let expected = (0..0x8000).map(|it| it % count);
        assert!(all.eq(expected));
    }

    #[test]
    fn the_first_byte_of_a_message_chooses_where_its_type_is() {
        let payload = &[0, 1, 0, 0, 7][..];
        let data = |head: &[u8]| [head, payload].concat();
        for (head, number) in [([0x80, 0], 0), ([0x80, 5], 5), ([0x81, 0], 256)] {
            let number = number % type_count();
            let data = data(&head);
            assert_eq!(Input::of(&data), Input::Typed { number, payload });
        }
        let data = data(b"int8 a\0");
        let text = "int8 a";
        assert_eq!(Input::of(&data), Input::Described { text, payload });
        assert_eq!(
            Input::of(&[0x80]),
            Input::Described {
                text: "",
                payload: &[]
            }
        );
    }

    #[test]
    fn every_type_is_visited_once() {
        struct Names(Vec<&'static str>);
        impl TypeVisitor for Names {
            fn visit<T: Viewed>(&mut self) {
                self.0.push(T::TYPE_NAME);
            }
        }
        let mut names = Names(Vec::new());
        for_each_type(&mut names);
        assert!(names.0.contains(&"std_msgs/msg/String"), "{:?}", names.0);
        assert_eq!(names.0.len(), type_count());
        names.0.sort_unstable();
        names.0.dedup();
        assert_eq!(names.0.len(), type_count());
    }
}
