//! The hash of each kind of type, computed from the hashes of its parts. All functions are `const`,
//! so that a program's types have their hashes at compile time.

/// The hash of a text: FNV-1a, 64 bits.
#[must_use]
pub const fn text(text: &str) -> u64 {
    Hasher::new().text(text).0
}

/// The hash of a structure with these fields: name and hash of the type.
#[must_use]
pub const fn structure(fields: &[(&str, u64)]) -> u64 {
    members("struct{", fields)
}

/// The hash of an enumeration with these variants: name and hash of the fields as a structure.
#[must_use]
pub const fn enumeration(variants: &[(&str, u64)]) -> u64 {
    members("enum{", variants)
}

/// The hash of `len` values of one type.
#[must_use]
pub const fn array(element: u64, len: u64) -> u64 {
    let elements = Hasher::new().text("array[").hex(element);
    elements.text(";").hex(len).text("]").0
}

/// The hash of a list of values of one type.
#[must_use]
pub const fn list(element: u64) -> u64 {
    Hasher::new().text("list[").hex(element).text("]").0
}

/// The hash of a list whose values differ from each other and have no order.
#[must_use]
pub const fn set(element: u64) -> u64 {
    Hasher::new().text("set[").hex(element).text("]").0
}

/// The hash of a list of pairs whose first values differ from each other.
#[must_use]
pub const fn map(key: u64, value: u64) -> u64 {
    let key = Hasher::new().text("map[").hex(key);
    key.text(",").hex(value).text("]").0
}

/// The hash of a value that may be absent.
#[must_use]
pub const fn option(value: u64) -> u64 {
    Hasher::new().text("option[").hex(value).text("]").0
}

/// The hash of a message type: an encoding, and the hash of the structure that is encoded.
#[must_use]
pub const fn message(encoding: &str, structure: u64) -> u64 {
    Hasher::new().text(encoding).text(":").hex(structure).0
}

/// The hash of a message type of ROS 2 in encoding `cdr`, from the 32 bytes of its RIHS01 hash.
#[must_use]
pub const fn cdr(rihs01: &[u8; 32]) -> u64 {
    let mut hasher = Hasher::new().text("cdr:RIHS01_");
    let mut rest = rihs01.as_slice();
    while let [byte, tail @ ..] = rest {
        hasher = hasher.digit(*byte >> 4).digit(*byte & 0xf);
        rest = tail;
    }
    hasher.0
}

const fn members(open: &str, members: &[(&str, u64)]) -> u64 {
    let mut hasher = Hasher::new().text(open);
    let mut rest = members;
    while let [(name, hash), tail @ ..] = rest {
        hasher = hasher.text(name).text(":").hex(*hash).text(",");
        rest = tail;
    }
    hasher.text("}").0
}

struct Hasher(u64);

impl Hasher {
    const fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    const fn byte(self, byte: u8) -> Self {
        Self((self.0 ^ byte as u64).wrapping_mul(0x0000_0100_0000_01b3))
    }

    const fn text(mut self, text: &str) -> Self {
        let mut rest = text.as_bytes();
        while let [byte, tail @ ..] = rest {
            self = self.byte(*byte);
            rest = tail;
        }
        self
    }

    const fn hex(mut self, value: u64) -> Self {
        let mut shift = 64;
        while shift > 0 {
            shift -= 4;
            self = self.digit((value >> shift) as u8 & 0xf);
        }
        self
    }

    const fn digit(self, value: u8) -> Self {
        self.byte(b"0123456789abcdef"[value as usize & 0xf])
    }
}
