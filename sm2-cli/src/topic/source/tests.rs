use std::{cell::Cell, io::Write, os::unix::fs::symlink, thread};

use super::*;

/// A gate that passes this number of times.
struct Passes(Cell<u32>);

impl Gate for Passes {
    fn pass(&self, input: BorrowedFd<'_>) -> Result<bool, CliError> {
        let left = self.0.get();
        self.0.set(left.saturating_sub(1));
        let ready = sm2_io::wait_readable(&[input], None);
        Ok(ready.map_err(CliError::system("wait"))? && left > 0)
    }
}

fn messages_of(path: &Path, split: Split) -> Vec<Vec<u8>> {
    let gate = Passes(Cell::new(u32::MAX));
    let inputs = Input::Path(path.to_owned()).inputs().unwrap();
    let mut messages = Messages::new(inputs, split, &gate);
    let mut all = Vec::new();
    let mut message = Vec::new();
    while messages.next(&mut message).unwrap() {
        all.push(message.clone());
    }
    all
}

fn file(content: &[u8]) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(content).unwrap();
    file
}

#[test]
fn a_file_is_one_message_whatever_is_in_it() {
    let every_byte: Vec<u8> = (0..=255).cycle().take(100_000).collect();
    for content in [&b""[..], b"\n", b"a\nb", &every_byte] {
        assert_eq!(messages_of(file(content).path(), Split::Whole), [content]);
    }
}

#[test]
fn lines_come_without_their_newline_and_nothing_else_changed() {
    for (content, expected) in [
        (&b""[..], &[][..]),
        (b"\n", &[&b""[..]]),
        (b"a", &[b"a"]),
        (b"a\n", &[b"a"]),
        (b"a\n\nb\r\n", &[b"a", b"", b"b\r"]),
        (b"\xff\0\n ", &[b"\xff\0", b" "]),
    ] {
        assert_eq!(messages_of(file(content).path(), Split::Lines), expected);
    }
}

#[test]
fn chunks_together_are_the_input() {
    let content: Vec<u8> = (0..100_001_u32).map(|at| at as u8).collect();
    let input = file(&content);
    for size in [1_000, 65_536, 100_000, 100_001, 200_000] {
        let chunks = messages_of(input.path(), Split::Chunks(size as u64));
        assert_eq!(chunks.concat(), content);
        let (last, full) = chunks.split_last().unwrap();
        assert!(full.iter().all(|chunk| chunk.len() == size));
        assert!(!last.is_empty() && last.len() <= size);
    }
    assert!(messages_of(file(b"").path(), Split::Chunks(4)).is_empty());
}

#[test]
fn a_folder_is_its_files_in_the_order_of_their_names() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["b", "a10", "a9", ".hidden", "Z"] {
        fs::write(folder.path().join(name), name).unwrap();
    }
    fs::create_dir(folder.path().join("c")).unwrap();
    symlink("b", folder.path().join("link")).unwrap();
    symlink("nowhere", folder.path().join("dangling")).unwrap();
    let messages = messages_of(folder.path(), Split::Whole);
    assert_eq!(messages, [&b"Z"[..], b"a10", b"a9", b"b", b"b"]);
}

#[test]
fn what_cannot_be_read_says_which_path_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let empty = Input::Path(folder.path().to_owned()).inputs();
    assert!(matches!(empty, Err(CliError::EmptyFolder { .. })));

    let missing = folder.path().join("missing");
    let error = Input::Path(missing.clone()).inputs().unwrap_err();
    let expected = format!(
        "cannot read {}: No such file or directory (os error 2): check the path",
        missing.display()
    );
    assert_eq!(error.to_string(), expected);

    // This file can be opened, but its first page is not mapped, so reading fails.
    let gate = Passes(Cell::new(u32::MAX));
    let inputs = Input::Path("/proc/self/mem".into()).inputs().unwrap();
    let mut messages = Messages::new(inputs, Split::Whole, &gate);
    let error = messages.next(&mut Vec::new()).unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("cannot read /proc/self/mem: ")
    );
}

#[test]
fn a_pipe_is_read_as_it_comes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipe");
    nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let writer = thread::spawn({
        let path = path.clone();
        move || {
            let mut pipe = File::options().write(true).open(path).unwrap();
            for line in ["one\n", "tw", "o\n", "three"] {
                pipe.write_all(line.as_bytes()).unwrap();
                pipe.flush().unwrap();
            }
        }
    });
    assert_eq!(
        messages_of(&path, Split::Lines),
        [&b"one"[..], b"two", b"three"]
    );
    writer.join().unwrap();
}

#[test]
fn a_closed_gate_ends_the_input() {
    let input = file(b"one\ntwo\n");
    let gate = Passes(Cell::new(0));
    let inputs = vec![Input::Path(input.path().to_owned())];
    let mut messages = Messages::new(inputs, Split::Lines, &gate);
    assert!(!messages.next(&mut Vec::new()).unwrap());
}
