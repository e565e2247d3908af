use super::*;
use crate::top::table::{Column, Table};

const COLUMNS: &[Column] = &[Column::test("TOPIC", 0), Column::test("HZ", 1)];

pub(in crate::top) fn figures() -> Figures {
    let row = |name: &str, hz| vec![Cell::Text(name.into()), Cell::Number(hz)];
    let topics = Table {
        columns: COLUMNS,
        rows: vec![
            row("image", Some(30.0)),
            row("scan", Some(100.25)),
            row("tf", None),
        ],
    };
    let nodes = Table {
        columns: COLUMNS,
        rows: vec![row("talker", Some(130.25))],
    };
    Figures { topics, nodes }
}

fn press(state: &mut State, code: KeyCode) -> After {
    state.key(KeyEvent::new(code, KeyModifiers::NONE), &figures())
}

fn names(state: &State) -> Vec<String> {
    let figures = figures();
    let rows = state.rows(&figures).into_iter();
    rows.map(|row| row[0].as_text().to_owned()).collect()
}

#[test]
fn rows_are_sorted_by_any_column_either_way() {
    let mut state = State::default();
    assert_eq!(names(&state), ["image", "scan", "tf"]);
    press(&mut state, KeyCode::Char('s'));
    // The largest number comes first, unknown ones last.
    assert_eq!(names(&state), ["scan", "image", "tf"]);
    press(&mut state, KeyCode::Char('r'));
    assert_eq!(names(&state), ["tf", "image", "scan"]);
    press(&mut state, KeyCode::Char('s'));
    assert_eq!(names(&state), ["tf", "scan", "image"]);
}

#[test]
fn a_filter_is_typed_kept_and_dropped() {
    let mut state = State::default();
    for c in "/A".chars() {
        press(&mut state, KeyCode::Char(c));
    }
    assert_eq!(names(&state), ["image", "scan"]);
    // Letters go to the filter, not to commands.
    assert_eq!(press(&mut state, KeyCode::Char('q')), After::GoOn);
    assert!(names(&state).is_empty());
    press(&mut state, KeyCode::Backspace);
    press(&mut state, KeyCode::Enter);
    assert_eq!(names(&state), ["image", "scan"]);
    press(&mut state, KeyCode::Esc);
    assert_eq!(names(&state).len(), 3);
}

#[test]
fn the_selection_stays_within_the_rows() {
    let mut state = State::default();
    press(&mut state, KeyCode::Up);
    assert_eq!(state.selected, 0);
    for _ in 0..5 {
        press(&mut state, KeyCode::Down);
    }
    assert_eq!(state.selected, 2);
    press(&mut state, KeyCode::Tab);
    assert_eq!((state.tab, state.selected), (Tab::Nodes, 0));
    press(&mut state, KeyCode::End);
    assert_eq!(state.selected, 0);
}

#[test]
fn a_page_has_ten_rows() {
    let mut figures = figures();
    let row = figures.topics.rows[0].clone();
    figures.topics.rows = vec![row; 25];
    let mut state = State::default();
    let mut after = |code| {
        state.key(KeyEvent::new(code, KeyModifiers::NONE), &figures);
        state.selected
    };
    let down = [KeyCode::PageDown; 3].map(&mut after);
    assert_eq!(down, [10, 20, 24]);
    let up = [KeyCode::PageUp; 3].map(&mut after);
    assert_eq!(up, [14, 4, 0]);
    assert_eq!([KeyCode::End, KeyCode::Home].map(after), [24, 0]);
}

#[test]
fn q_and_ctrl_c_end_it() {
    assert_eq!(
        press(&mut State::default(), KeyCode::Char('q')),
        After::Quit
    );
    let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    let mut state = State {
        filter: Filter {
            is_typed: true,
            ..Filter::default()
        },
        ..State::default()
    };
    assert_eq!(state.key(control_c, &figures()), After::Quit);
}
