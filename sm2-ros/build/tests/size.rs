//! Definitions whose types do not fit the stack.

use sm2_ros_build::Error;

use crate::common::{Definitions, code_of};

/// The most bytes of a type, as the documentation of the crate states.
const MOST: usize = 128 << 10;

#[test]
fn a_type_that_does_not_fit_the_stack_is_refused() {
    for (whole, part) in [
        ("U[20] a\n", "float64[1600] b\n"),
        ("U a\n", "float64[1000000000] b\n"),
        ("U[4294967295] a\n", "string[4294967295] b\n"),
    ] {
        let definitions = Definitions::new(&[("msg/T.msg", whole), ("msg/U.msg", part)]);
        let error = definitions.code().unwrap_err();
        assert!(matches!(error, Error::TooLarge(..)), "{error}");
    }
    let fields = [
        ("msg/T.msg", "U[10] a\n"),
        ("msg/U.msg", "float64[1600] b\nuint8[] c\n"),
    ];
    Definitions::new(&fields).code().unwrap();
}

/// The content of texts and sequences is not on the stack.
#[test]
fn the_largest_type_has_128_kib() {
    code_of(&format!("int64[{}] a\n", MOST / 8)).unwrap();
    for more in ["bool b", "string b", "int8[] b"] {
        match code_of(&format!("int64[{}] a\n{more}\n", MOST / 8)) {
            Err(Error::TooLarge(name, size)) => {
                assert_eq!(name.to_string(), "p/msg/T");
                assert!(size > MOST, "{size}");
            }
            other => panic!("{more}: {other:?}"),
        }
    }
}
