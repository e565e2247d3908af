//! Definitions whose types do not fit the stack.

use std::fs;

use sm2_ros_build::{Builder, Error};

#[test]
fn a_type_that_does_not_fit_the_stack_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let package = folder.path().join("p");
    fs::create_dir_all(package.join("msg")).unwrap();
    let write = |name: &str, text: &str| fs::write(package.join("msg").join(name), text).unwrap();
    let code = || {
        Builder::new()
            .common_interfaces(false)
            .package(&package)
            .code()
    };
    write("T.msg", "U[10] a\n");
    write("U.msg", "float64[1600] b\nuint8[] c\n");
    code().unwrap();
    for (whole, part) in [
        ("U[20] a\n", "float64[1600] b\n"),
        ("U a\n", "float64[1000000000] b\n"),
        ("U[4294967295] a\n", "string[4294967295] b\n"),
    ] {
        write("T.msg", whole);
        write("U.msg", part);
        let error = code().unwrap_err();
        assert!(matches!(error, Error::TooLarge(..)), "{error}");
    }
}
