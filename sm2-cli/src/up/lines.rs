//! Cuts the output of a program into lines.

use super::limits::LINE_MAX_BYTES;

/// The beginning of a line whose end has not come yet.
#[derive(Debug, Default)]
pub(super) struct Lines(Vec<u8>);

impl Lines {
    /// Takes more output, and returns the lines that are complete.
    pub(super) fn push(&mut self, mut bytes: &[u8]) -> Vec<String> {
        let mut lines = Vec::new();
        while !bytes.is_empty() {
            let room = LINE_MAX_BYTES - self.0.len();
            let head = &bytes[..bytes.len().min(room)];
            let end = head.iter().position(|byte| *byte == b'\n');
            self.0.extend_from_slice(&head[..end.unwrap_or(head.len())]);
            bytes = &bytes[end.map_or(head.len(), |end| end + 1)..];
            if end.is_some() || self.0.len() == LINE_MAX_BYTES {
                lines.extend(self.take(end.is_some()));
            }
        }
        lines
    }

    /// The last line, if it has no end.
    pub(super) fn finish(&mut self) -> Option<String> {
        self.take(false)
    }

    /// The line so far. An empty one counts only with its end.
    fn take(&mut self, has_end: bool) -> Option<String> {
        let bytes = std::mem::take(&mut self.0);
        if bytes.is_empty() && !has_end {
            return None;
        }
        let bytes = bytes.strip_suffix(b"\r").unwrap_or(&bytes);
        Some(String::from_utf8_lossy(bytes).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_where_their_program_ended_them() {
        let mut lines = Lines::default();
        assert_eq!(lines.push(b"a\n\nb\r\nc"), ["a", "", "b"]);
        assert_eq!(lines.push(b"d\n"), ["cd"]);
        assert_eq!(lines.finish(), None);
        assert!(lines.push(&[0xff, b'e']).is_empty());
        assert_eq!(lines.finish().as_deref(), Some("\u{fffd}e"));
    }

    #[test]
    fn a_line_without_an_end_is_cut() {
        let mut lines = Lines::default();
        let cut = lines.push(&[b'x'; 2 * LINE_MAX_BYTES + 1]);
        let lens: Vec<_> = cut.iter().map(String::len).collect();
        assert_eq!(lens, [LINE_MAX_BYTES, LINE_MAX_BYTES]);
        assert_eq!(lines.finish().as_deref(), Some("x"));
    }
}
