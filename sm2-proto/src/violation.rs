//! A breach of SPEC: its kind as frames carry it, and the clause that it breaks.

use core::fmt;

use crate::{Clause, Code, ViolationKind};

/// A breach of SPEC by the other side. It ends the session or the link.
///
/// The code that finds a violation names both parts. The [kind](Self::kind) goes out on the wire.
/// The [clause](Self::clause) goes into the log: one kind can break several clauses, so the clause
/// does not follow from the kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Violation<K = ViolationKind> {
    kind: K,
    clause: Clause,
}

impl<K: Copy> Violation<K> {
    /// A violation of this kind, which breaks this clause.
    #[must_use]
    pub const fn new(kind: K, clause: Clause) -> Self {
        Self { kind, clause }
    }

    /// The name that the violation has in SPEC's table of codes.
    #[must_use]
    pub const fn kind(self) -> K {
        self.kind
    }

    /// The clause that was broken.
    #[must_use]
    pub const fn clause(self) -> Clause {
        self.clause
    }

    /// The code that frames carry.
    #[must_use]
    pub fn code(self) -> Code
    where
        K: Into<Code>,
    {
        self.kind.into()
    }
}

impl<K: fmt::Display> fmt::Display for Violation<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.kind, self.clause)
    }
}

impl<K: fmt::Debug + fmt::Display> core::error::Error for Violation<K> {}

impl<K: Into<Code>> From<Violation<K>> for Code {
    fn from(violation: Violation<K>) -> Self {
        violation.kind.into()
    }
}

/// Makes a [`Violation`] of a kind and a clause. The macro stands where the breach is found.
///
/// The kind is one of [`ViolationKind`], or of another table if that is named:
///
/// ```
/// use sm2_proto::{ViolationKind, violation};
///
/// let found = violation!(BadWord, "SM2-RNG-005");
/// assert_eq!(found.to_string(), "bad-word (SM2-RNG-005)");
/// assert_eq!(found, violation!(ViolationKind::BadWord, "SM2-RNG-005"));
/// ```
#[macro_export]
macro_rules! violation {
    ($kind:ident, $clause:literal) => {
        $crate::Violation::new($crate::ViolationKind::$kind, $crate::clause!($clause))
    };
    ($kinds:ident::$kind:ident, $clause:literal) => {
        $crate::Violation::new($kinds::$kind, $crate::clause!($clause))
    };
}
