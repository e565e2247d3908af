use super::*;

/// The program `true`, which every machine has.
const FINE: &str = "[program.a]\ncommand = 'true'\n";

/// Checks a text as the file `robot.toml` of a folder.
fn check(text: &str) -> Result<Robot, String> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("robot.toml"), text).unwrap();
    fs::write(folder.path().join("params.toml"), "[a]\nx = 1\n").unwrap();
    fs::write(folder.path().join("wrong.toml"), "x = 1\n").unwrap();
    let loaded = load(&folder.path().join("robot.toml"));
    loaded.map_err(|error| {
        let folder = fs::canonicalize(folder.path()).unwrap();
        error
            .to_string()
            .replace(&format!("{}/", folder.display()), "")
    })
}

#[test]
fn a_file_has_defaults_and_the_order_of_its_programs() {
    let robot = check(&format!(
        "{FINE}[program.zebra]\ncommand = ['true', 'a b']\nrestart = 'never'\n\
         [program.bear]\ncommand = \"true 'c d' e\"\nmax_restarts = 0\nafter = ['topic:/scan links>0']\n"
    ));
    let robot = robot.unwrap();
    assert_eq!(robot.name, "robot");
    assert!(robot.has_manager && robot.domain.is_none());
    assert_eq!(robot.stop_timeout, STOP_TIMEOUT);
    let names: Vec<_> = robot.programs.iter().map(|it| it.name.as_str()).collect();
    assert_eq!(names, ["a", "zebra", "bear"]);
    let [a, zebra, bear] = &robot.programs[..] else {
        unreachable!()
    };
    assert_eq!(
        (a.policy, a.max_restarts),
        (RestartPolicy::OnFailure, RESTARTS)
    );
    assert_eq!((zebra.policy, bear.max_restarts), (RestartPolicy::Never, 0));
    assert_eq!(zebra.command, ["true", "a b"]);
    assert_eq!(bear.command, ["true", "c d", "e"]);
    assert_eq!(bear.after[0].text(), "topic:/scan links>0");
}

#[test]
fn paths_are_those_of_the_folder_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("bin")).unwrap();
    fs::copy("/bin/true", at("bin/fine")).unwrap();
    fs::write(at("params.toml"), "[a]\nx = 1\n").unwrap();
    let text = "[program.a]\ncommand = './fine'\ndirectory = 'bin'\nparams = 'params.toml'\n\
                environment = { X = '1' }\n";
    fs::write(at("robot.toml"), text).unwrap();
    let robot = load(&at("robot.toml")).unwrap();
    let a = &robot.programs[0];
    let full = fs::canonicalize(folder.path()).unwrap();
    assert_eq!(Path::new(&a.command[0]), full.join("bin/./fine"));
    assert_eq!(a.folder, full.join("bin"));
    let params = full.join("params.toml").to_str().unwrap().to_owned();
    let expected = [
        ("SM2_PARAMS".to_owned(), params),
        ("X".to_owned(), "1".to_owned()),
    ];
    assert_eq!(a.environment, expected);
}

#[test]
fn the_params_of_the_file_are_those_of_programs_without_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["all.toml", "own.toml"] {
        fs::write(at(name), "[a]\nx = 1\n").unwrap();
    }
    let text = "params = 'all.toml'\n[program.a]\ncommand = 'true'\n\
                [program.b]\ncommand = 'true'\nparams = 'own.toml'\n";
    fs::write(at("robot.toml"), text).unwrap();
    let robot = load(&at("robot.toml")).unwrap();
    let full = fs::canonicalize(folder.path()).unwrap();
    for (program, name) in robot.programs.iter().zip(["all.toml", "own.toml"]) {
        let path = full.join(name).to_str().unwrap().to_owned();
        assert_eq!(program.environment, [("SM2_PARAMS".to_owned(), path)]);
    }
}

/// Checks that each text is refused with an error that begins with its place.
fn refused(cases: &[(&str, &str)]) {
    for (text, expected) in cases {
        let error = check(text).unwrap_err();
        let place = error.split_once("robot.toml:");
        let place = place.map_or("", |(_, place)| place);
        let found = error.ends_with(place) && place.starts_with(expected);
        assert!(found, "{text}: {expected:?} is not in {error:?}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn errors_of_the_form_have_their_place() {
    refused(&[
        (
            "",
            "1:1: the file has no program: add a table such as `[program.lidar]`",
        ),
        (
            "domain = 1\n",
            "1:10: invalid type: integer `1`, expected a string",
        ),
        ("x = [", "1:6: unclosed array, expected `]`"),
        (
            "[program.a]\ncomand = 'true'\n",
            "2:1: unknown field `comand`, expected one of `command`",
        ),
        ("[program.a]\n", "1:1: missing field `command`"),
        (
            "[program.a]\ncommand = 1\n",
            "2:11: invalid type: integer `1`, expected a text",
        ),
        ("[program.a]\ncommand = ''\n", "2:11: the command is empty"),
        ("[program.a]\ncommand = []\n", "2:11: the command is empty"),
        (
            "[program.a]\ncommand = ['']\n",
            "2:11: the command is empty",
        ),
        (
            "[program.a]\ncommand = '\"true'\n",
            "2:11: a quote or a backslash",
        ),
        (
            "[program.a]\ncommand = \"true \\u0000\"\n",
            "2:11: a text for a program has no character 0",
        ),
        (
            "[program.a]\ncommand = 'bin/none'\n",
            "2:11: there is no program bin/none",
        ),
        (
            "[program.a]\ncommand = 'no-such-program'\n",
            "2:11: there is no program no-such-program",
        ),
        (
            "[program.a]\ncommand = './robot.toml'\n",
            "2:11: there is no program ./robot.toml",
        ),
    ]);
    let missing = load(Path::new("/none/robot.toml")).unwrap_err();
    assert!(missing.to_string().contains("`sm2 new`"), "{missing}");
}

#[test]
fn errors_of_values_have_their_place_and_a_remedy() {
    let long = "x".repeat(NAME_MAX + 1);
    refused(&[
        (
            "[program.'a b']\ncommand = 'true'\n",
            "1:10: a program's name has 1 to 64",
        ),
        (
            &format!("[program.{long}]\ncommand = 'true'\n"),
            "1:10: a program's name has 1 to 64",
        ),
        (
            "[program.manager]\ncommand = 'true'\n",
            "1:10: `manager` is the name of the Manager",
        ),
        (
            &format!("{FINE}directory = 'none'\n"),
            "3:13: none is no directory: make it, or correct `directory`",
        ),
        (
            &format!("{FINE}params = 'none.toml'\n"),
            "3:10: cannot read the parameters",
        ),
        (
            &format!("{FINE}params = 'wrong.toml'\n"),
            "3:10: wrong.toml:1: x is outside of the table of a node",
        ),
        (
            &format!("{FINE}environment = {{ 'A=B' = '1' }}\n"),
            "3:17: `A=B` is no name",
        ),
        (
            &format!("{FINE}environment = {{ A = 1 }}\n"),
            "3:21: invalid type: integer `1`, expected a string",
        ),
        (
            &format!("{FINE}after = ['topic:b publisher>=1']\n"),
            "3:10: at character 9 (publisher>=1): expected publishers>=1",
        ),
        (
            &format!("{FINE}restart = 'sometimes'\n"),
            "3:11: unknown variant `sometimes`",
        ),
        (
            &format!("stop_timeout = '5'\n{FINE}"),
            "1:16: a time is a number and a unit",
        ),
        (&format!("{FINE}{FINE}"), "3:10: duplicate key"),
    ]);
}

#[test]
fn a_program_may_be_named_manager_if_none_is_started() {
    let robot = check("manager = false\n[program.manager]\ncommand = 'true'\n").unwrap();
    assert!(!robot.has_manager);
    assert_eq!(robot.programs[0].name, "manager");
}
