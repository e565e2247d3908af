use ratatui::{Terminal, backend::TestBackend, buffer::Buffer};

use super::*;
use crate::top::state::{Filter, tests::figures};

fn buffer(
    figures: &Figures,
    history: &History,
    state: &mut State,
    width: u16,
    height: u16,
) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal
        .draw(|frame| draw(frame, figures, history, state))
        .unwrap();
    terminal.backend().buffer().clone()
}

/// The lines of a screen of this size.
fn screen(state: &mut State, width: u16, height: u16) -> Vec<String> {
    screen_of(&figures(), state, width, height)
}

fn screen_of(figures: &Figures, state: &mut State, width: u16, height: u16) -> Vec<String> {
    let buffer = buffer(figures, &History::default(), state, width, height);
    let lines = buffer.content().chunks(usize::from(width));
    lines
        .map(|line| {
            let line: String = line.iter().map(ratatui::buffer::Cell::symbol).collect();
            line.trim_end().to_owned()
        })
        .collect()
}

#[test]
fn topics_are_drawn_with_a_heading_and_keys() {
    let expected = [
        "sm2 top  [3 topics]  1 node",
        "TOPICv     HZ  TREND",
        "image    30.0",
        "scan    100.2",
        "tf          -",
        "q quit  Tab topics/nodes  s sort  r reverse  / filter",
    ];
    assert_eq!(screen(&mut State::default(), 60, 6), expected);
}

#[test]
fn a_filter_and_a_lost_manager_are_shown() {
    let mut state = State {
        tab: Tab::Nodes,
        filter: Filter {
            text: "talk".into(),
            ..Filter::default()
        },
        connected: false,
        ..State::default()
    };
    let lines = screen(&mut state, 80, 4);
    assert!(lines[0].contains("the Manager is gone"), "{lines:?}");
    assert!(lines[2].starts_with("talker"), "{lines:?}");
    assert!(lines[3].starts_with("names with \"talk\""), "{lines:?}");
}

/// The rows of both tables on screens of usual widths. No cell is cut: see the help.
#[test]
fn columns_that_do_not_fit_are_left_out() {
    for (width, topics, nodes) in WIDTHS {
        for (tab, expected) in [(Tab::Topics, topics), (Tab::Nodes, nodes)] {
            let mut state = State {
                tab,
                ..State::default()
            };
            let lines = screen_of(&Figures::large(), &mut state, *width, 4);
            assert_eq!(lines[1..], **expected, "{tab:?} at {width} columns");
        }
    }
}

#[test]
fn the_help_states_the_order_of_leaving_out() {
    let help = crate::top::HELP.split_whitespace().collect::<Vec<_>>();
    let help = help.join(" ");
    let figures = Figures::large();
    for (title, table) in [("Topics", &figures.topics), ("Nodes", &figures.nodes)] {
        let mut columns = table.columns[1..].to_vec();
        columns.sort_by_key(|column| column.rank);
        let headings: Vec<_> = columns.iter().map(|column| column.heading).collect();
        let order = format!("{title}: {}.", headings.join(", "));
        assert!(help.contains(&order), "{order}");
    }
}

#[test]
fn the_column_of_the_order_stays() {
    let mut state = State {
        sort: 1,
        ..State::default()
    };
    let lines = screen_of(&Figures::large(), &mut state, 40, 4);
    assert_eq!(lines[1], "TOPIC               TYPEv");
}

#[test]
fn only_a_name_that_is_wider_than_the_screen_is_shortened() {
    let lines = screen_of(&Figures::large(), &mut State::default(), 10, 4);
    assert_eq!(lines[2], "camera/fr…");
}

/// The history of a topic whose rate doubles.
fn doubling() -> History {
    let mut history = History::default();
    for hz in [25.0, 50.0, 100.0] {
        let mut figures = figures();
        figures.topics.rows[1][1] = Cell::Number(Some(hz));
        history.add(&figures);
    }
    history
}

#[test]
fn sparklines_take_the_room_that_is_left() {
    let lines = |width| {
        let buffer = buffer(&figures(), &doubling(), &mut State::default(), width, 6);
        let lines = buffer.content().chunks(usize::from(width));
        let line =
            |it: &[ratatui::buffer::Cell]| it.iter().map(|it| it.symbol()).collect::<String>();
        lines.map(line).collect::<Vec<_>>()
    };
    assert_eq!(lines(23)[3], "scan    100.2  ▃▄▇     ");
    assert_eq!(lines(22)[3], "scan    100.2         ");
    // Unknown rates are blank.
    assert_eq!(lines(23)[4], "tf          -          ");
}

#[test]
fn losses_are_red_where_there_are_colours() {
    for colours in [true, false] {
        let mut state = State {
            selected: 9,
            colours,
            ..State::default()
        };
        let mut figures = Figures::large();
        let no_losses = figures.topics.rows[0]
            .iter()
            .map(|it| match it {
                Cell::Number(Some(_)) => Cell::Number(Some(0.0)),
                other => other.clone(),
            })
            .collect();
        figures.topics.rows.push(no_losses);
        let buffer = buffer(&figures, &History::default(), &mut state, 100, 5);
        let red = |line: u16| {
            let cells = (0..100).map(|column| &buffer[(column, line)]);
            let red = cells.filter(|it| it.fg == Color::Red);
            red.map(|it| it.symbol()).collect::<String>()
        };
        // DROPPED, LOST, LOSS/s, MISS/s and STALL s.
        let expected = if colours {
            "1234567987651234.510.086400.0"
        } else {
            ""
        };
        assert_eq!(red(2).replace(' ', ""), expected);
        assert_eq!(red(3), "");
        state.connected = false;
        let buffer = self::buffer(&figures, &History::default(), &mut state, 100, 5);
        assert_eq!(buffer[(0, 0)].fg == Color::Red, colours);
    }
}

/// Columns that have only zeros leave their room to the others, unless the rows are sorted by them.
#[test]
fn columns_of_troubles_are_shown_while_there_are_some() {
    let mut figures = Figures::large();
    let headings = |figures: &Figures, sort| {
        let mut state = State {
            sort,
            ..State::default()
        };
        screen_of(figures, &mut state, 200, 4)[1].clone()
    };
    let has = |line: &str| ["MISS/s", "HELD", "STALL s"].map(|it| line.contains(it));
    assert_eq!(has(&headings(&figures, 0)), [true; 3]);
    let columns = figures.topics.columns.iter();
    let at = |heading| {
        columns
            .clone()
            .position(|it| it.heading == heading)
            .unwrap()
    };
    let (missed, held, stalled) = (at("MISS/s"), at("HELD"), at("STALL s"));
    figures.topics.rows[0][stalled] = Cell::Number(Some(0.0));
    assert_eq!(has(&headings(&figures, 0)), [true, false, false]);
    figures.topics.rows[0][missed] = Cell::Number(None);
    assert_eq!(has(&headings(&figures, 0)), [false; 3]);
    assert_eq!(has(&headings(&figures, held)), [false, true, false]);
}

#[test]
fn any_size_can_be_drawn() {
    for (width, height) in [(1, 1), (2, 3), (10, 2), (300, 1)] {
        screen(&mut State::default(), width, height);
    }
}

#[test]
fn text_is_the_whole_table() {
    let expected = [
        "TOPIC      HZ",
        "image    30.0",
        "scan    100.2",
        "tf          -",
    ];
    assert_eq!(text(&figures(), Tab::Topics), expected);
}

/// Widths of a screen, and the lines below its first one for topics and for nodes.
const WIDTHS: &[(u16, &[&str], &[&str])] = &[
    (
        40,
        &[
            "TOPICv                    HZ   STALL s",
            "camera/front/image  30000.25   86400.0",
            "11 columns hidden  q quit",
        ],
        &[
            "NODEv             OUT/s   STALL s",
            "camera-driver  30000.25   86400.0",
            "12 columns hidden  q quit",
        ],
    ),
    (
        60,
        &[
            "TOPICv                    HZ   LOST   LOSS/s   STALL s",
            "camera/front/image  30000.25  98765   1234.5   86400.0",
            "9 columns hidden  q quit  Tab topics/nodes  s sort",
        ],
        &[
            "NODEv           CPU %     OUT/s      IN/s   LOSS/s   STALL s",
            "camera-driver   123.4  30000.25  12345.50   1234.5   86400.0",
            "9 columns hidden  q quit  Tab topics/nodes  s sort",
        ],
    ),
    (
        80,
        &[
            "TOPICv                    HZ     MB/s   P50 ms   LOST   LOSS/s   STALL s",
            "camera/front/image  30000.25  745.700    5.715  98765   1234.5   86400.0",
            "7 columns hidden  q quit  Tab topics/nodes  s sort  r reverse  / filter",
        ],
        &[
            "NODEv           CPU %     OUT/s      IN/s   LOST   LOSS/s   MISS/s   STALL s",
            "camera-driver   123.4  30000.25  12345.50  98765   1234.5     10.0   86400.0",
            "7 columns hidden  q quit  Tab topics/nodes  s sort  r reverse  / filter",
        ],
    ),
    (
        120,
        &[
            "TOPICv               PUBS   SUBS   LINKS        HZ     MB/s   P50 ms   DROPPED   LOST   LOSS/s   \
             MISS/s   HELD   STALL s",
            "camera/front/image      2     12      24  30000.25  745.700    5.715   1234567  98765   1234.5     \
             10.0     16   86400.0",
            "1 column hidden  q quit  Tab topics/nodes  s sort  r reverse  / filter",
        ],
        &[
            "NODEv           CPU %     OUT/s   OUT MB/s      IN/s   IN MB/s   DROPPED   LOST   LOSS/s   MISS/s   \
             HELD   STALL s",
            "camera-driver   123.4  30000.25    745.700  12345.50  1234.568   1234567  98765   1234.5     10.0     \
             16   86400.0",
            "3 columns hidden  q quit  Tab topics/nodes  s sort  r reverse  / filter",
        ],
    ),
    (
        200,
        &[
            "TOPICv              TYPE           PUBS   SUBS   LINKS        HZ     MB/s   P50 ms   DROPPED   \
             LOST   LOSS/s   MISS/s   HELD   STALL s  TREND",
            "camera/front/image  sensor/Image      2     12      24  30000.25  745.700    5.715   1234567  \
             98765   1234.5     10.0     16   86400.0",
            "q quit  Tab topics/nodes  s sort  r reverse  / filter",
        ],
        &[
            "NODEv              PID   CPU %   IFACES   LINKS     OUT/s   OUT MB/s      IN/s   IN MB/s   DROPPED   \
             LOST   LOSS/s   MISS/s   HELD   STALL s  TREND",
            "camera-driver  1234567   123.4       14      48  30000.25    745.700  12345.50  1234.568   1234567  \
             98765   1234.5     10.0     16   86400.0",
            "q quit  Tab topics/nodes  s sort  r reverse  / filter",
        ],
    ),
];
