//! The id of a clause of SPEC.md, as a violation carries it.

use core::fmt;

/// The id of one clause of SPEC.md, such as `SM2-RNG-004`, in 6 bytes.
///
/// The macro [`clause!`](crate::clause!) makes one while the program is compiled. The `clauses`
/// check of this repository finds each use of the macro, and fails if SPEC.md does not have the
/// clause or does not keep it in force.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Clause {
    area: [u8; 3],
    number: u16,
}

impl Clause {
    /// Reads `SM2-`, three capital letters, `-`, and three digits.
    ///
    /// # Panics
    /// `id` is anything else. [`clause!`](crate::clause!) makes this an error of compilation.
    #[must_use]
    pub const fn new(id: &str) -> Self {
        let [b'S', b'M', b'2', b'-', a, b, c, b'-', x, y, z] = *id.as_bytes() else {
            panic!("not of the form SM2-ABC-000");
        };
        assert!(a.is_ascii_uppercase() && b.is_ascii_uppercase() && c.is_ascii_uppercase());
        assert!(x.is_ascii_digit() && y.is_ascii_digit() && z.is_ascii_digit());
        let number = (x - b'0') as u16 * 100 + (y - b'0') as u16 * 10 + (z - b'0') as u16;
        Self {
            area: [a, b, c],
            number,
        }
    }
}

impl fmt::Display for Clause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c] = self.area.map(char::from);
        write!(f, "SM2-{a}{b}{c}-{:03}", self.number)
    }
}

impl fmt::Debug for Clause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Makes a [`Clause`] of a literal. An id of another form does not compile.
#[macro_export]
macro_rules! clause {
    ($id:literal) => {
        const { $crate::Clause::new($id) }
    };
}
