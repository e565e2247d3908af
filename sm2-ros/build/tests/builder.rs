//! The options of the builder.

use std::fs;

use sm2_ros_build::Error;

use crate::common::{Definitions, assert_lines};

#[test]
fn the_file_has_the_chosen_name_and_folder() {
    let definitions = Definitions::new(&[("msg/T.msg", "int8 a\n")]);
    let out = definitions.path("out");
    fs::create_dir(&out).unwrap();
    let builder = definitions.builder().out_dir(&out);
    builder.generate().unwrap();
    builder.clone().file_name("other.rs").generate().unwrap();
    for name in ["sm2_ros_types.rs", "other.rs"] {
        let text = fs::read_to_string(out.join(name)).unwrap();
        assert_eq!(text, builder.code().unwrap(), "{name}");
    }
    assert_eq!(fs::read_dir(&out).unwrap().count(), 2);
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error() {
    let definitions = Definitions::new(&[("msg/T.msg", "int8 a\n")]);
    let builder = definitions.builder();
    // Cargo sets OUT_DIR for build scripts, and not for these tests.
    assert_eq!(std::env::var_os("OUT_DIR"), None);
    assert!(matches!(builder.generate(), Err(Error::NoOutDir)));
    let missing = definitions.path("missing");
    match builder.out_dir(&missing).generate() {
        Err(Error::Io { path, .. }) => assert_eq!(path, missing.join("sm2_ros_types.rs")),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_package_is_there_once() {
    let definitions = Definitions::new(&[("msg/T.msg", "int8 a\n")]);
    definitions.write("other/p/msg/U.msg", "int8 a\n");
    let second = definitions.path("other/p");
    let builder = definitions.builder();
    for twice in [
        builder.clone().package(&second),
        builder.external(&second, "::elsewhere"),
    ] {
        match twice.code() {
            Err(Error::PackageTwice { folder, package }) => {
                assert_eq!((folder, &*package), (second.clone(), "p"));
            }
            other => panic!("{other:?}"),
        }
    }
}

/// The types of an external package are known, but their code is in its module.
#[test]
fn the_types_of_an_external_package_are_those_of_its_module() {
    let definitions = Definitions::new(&[("msg/T.msg", "q/U u\n")]);
    definitions.write("q/msg/U.msg", "int8 a\n");
    let builder = definitions.builder();
    let unknown = builder.code().unwrap_err();
    assert!(matches!(unknown, Error::Set(_)), "{unknown}");
    let q = definitions.path("q");
    let code = builder.clone().external(&q, "::other::ros").code().unwrap();
    assert_lines(&code, &["pub u: ::other::ros::q::msg::U,"]);
    assert!(!code.contains("pub mod q"), "{code}");
    assert!(!code.contains("visit::<q::"), "{code}");
    let code = builder.clone().package(&q).code().unwrap();
    assert_lines(&code, &["pub u: super::super::q::msg::U,", "pub mod q {"]);
    let wrong = builder.external(&q, "not a path").code().unwrap_err();
    assert!(
        matches!(&wrong, Error::Path(path) if path == "not a path"),
        "{wrong}"
    );
}

#[test]
fn the_common_interfaces_are_those_of_sm2_ros() {
    let definitions = Definitions::new(&[("msg/T.msg", "std_msgs/Header header\n")]);
    let builder = definitions.builder();
    let code = builder.code().unwrap();
    assert_lines(&code, &["pub header: ::sm2_ros::std_msgs::msg::Header,"]);
    let error = builder.clone().common_interfaces(false).code().unwrap_err();
    assert!(matches!(error, Error::Set(_)), "{error}");
    // A package of the same name takes the place of a common one.
    definitions.write("std_msgs/msg/Header.msg", "int8 own\n");
    let code = builder.package(definitions.path("std_msgs")).code();
    let code = code.unwrap();
    assert_lines(
        &code,
        &[
            "pub header: super::super::std_msgs::msg::Header,",
            "pub own: i8,",
        ],
    );
}
