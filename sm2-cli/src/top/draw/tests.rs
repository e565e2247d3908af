use ratatui::{Terminal, backend::TestBackend};

use super::*;
use crate::top::state::tests::figures;

/// What is on a screen of this size.
fn screen(state: &mut State, width: u16, height: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal
        .draw(|frame| draw(frame, &figures(), state))
        .unwrap();
    let buffer = terminal.backend().buffer().clone();
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
        "sm2 top  [3 topics]  1 nodes",
        "TOPICv     HZ",
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
        filter: "talk".into(),
        connected: false,
        ..State::default()
    };
    let lines = screen(&mut state, 80, 4);
    assert!(lines[0].contains("the Manager is gone"), "{lines:?}");
    assert!(lines[2].starts_with("talker"), "{lines:?}");
    assert!(lines[3].starts_with("names with \"talk\""), "{lines:?}");
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
