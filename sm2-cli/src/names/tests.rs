use super::*;

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

#[test]
fn what_is_mistyped_has_a_hint() {
    let known = [name("robot/scan"), name("image"), name("tf")];
    for (typed, hint_text) in [
        ("imgae", "; did you mean image?"),
        ("Image", "; did you mean image?"),
        ("images", "; did you mean image?"),
        ("scan", "; did you mean robot/scan?"),
        ("odometry", ""),
        ("x", ""),
    ] {
        assert_eq!(hint(typed, &known), hint_text, "{typed}");
    }
}

#[test]
fn a_mistyped_glob_has_a_hint() {
    let known = [name("camera/left"), name("camera/right"), name("scan")];
    for (typed, hint_text) in [
        ("camra/*", "; did you mean camera/left?"),
        ("camra/r*", "; did you mean camera/right?"),
        ("sacn", "; did you mean scan?"),
        ("lidar/*", ""),
        ("camera/*/raw", ""),
    ] {
        assert_eq!(pattern_hint(typed, &known), hint_text, "{typed}");
    }
}

#[test]
fn a_selector_is_a_name_or_a_node_and_a_name() {
    let parse = |text| Selector::parse(text);
    let both = parse("talker:/robot/scan").unwrap();
    assert_eq!(both.node, Some(name("talker")));
    assert_eq!(both.name, name("robot/scan"));
    assert_eq!(parse("/scan").unwrap().node, None);
    for wrong in ["", ":", "a:", ":b", "a b", "a:b:c"] {
        assert!(parse(wrong).is_err(), "{wrong}");
    }
}
