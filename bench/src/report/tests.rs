use super::{between_marks, json_lines, markdown, rewrite, table};
use crate::results::tests::results;

#[test]
fn a_table_has_median_range_ratio_and_who_failed() {
    let text = table(&results());
    let line = |start: &str| {
        let mut lines = text.lines();
        let line = lines.find(|line| line.starts_with(start));
        line.unwrap_or_else(|| panic!("no {start} in\n{text}"))
    };
    assert!(line("1to5").ends_with("cpu, %"));
    assert!(line("raw-futex").ends_with("1.50 (1.00-2.00) 0.500x"));
    assert!(line("sm2").ends_with("3.00 (2.00-4.00)"));
    assert!(line("zenoh-tcp (failed 1 of 3)").len() > 10);
    assert!(line("zenoh-tcp failed in repeat 2 1to5: publisher: broken").len() > 10);
}

#[test]
fn each_figure_and_failure_is_one_line_of_json() {
    let results = results();
    let text = json_lines(&results).unwrap();
    let objects: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(objects.len(), results.figures.len() + 1);
    assert!(objects[0]["median"].is_number());
    assert_eq!(objects[objects.len() - 1]["failed"], "publisher: broken");
}

#[test]
fn only_what_is_between_the_marks_changes() {
    let text = "a\n<!-- results: begin -->\nold\n<!-- results: end -->\nb\n";
    let new = between_marks(text, "new\n").unwrap();
    assert_eq!(
        new,
        "a\n<!-- results: begin -->\n\nnew\n\n<!-- results: end -->\nb\n"
    );
    assert_eq!(between_marks(&new, "new\n").unwrap(), new);
    assert_eq!(between_marks("no marks", "new"), None);
}

#[test]
fn a_document_without_marks_stays_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("README.md");
    std::fs::write(&path, "text").unwrap();
    assert!(rewrite(&path, &[results()]).is_err());
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "text");
}

#[test]
fn a_document_has_a_table_for_each_case_and_the_command() {
    let text = markdown(&[results()]);
    assert!(text.contains("| 1to5 | cpu, % |\n| --- | --- |\n"));
    assert!(text.contains("| 1to1 | cpu, % |"));
    assert!(text.contains("`sm2-bench run fig3`"));
    assert!(text.contains("results/plots/fig3-full-cpu.svg"));
}
