//! A second decoder of frames, headers and beacons, written by hand from SPEC section 14 alone. It
//! returns the meaning as JSON with the names of SPEC, or the name of the violation.

use serde_json::{Value, json};

pub(crate) type Read<T> = Result<T, &'static str>;

/// Decodes the received part of a control stream. Returns its frames, then the number of bytes behind
/// the last one, or the violation.
pub(crate) fn stream(bytes: &[u8]) -> (Vec<Value>, Read<usize>) {
    let mut frames = Vec::new();
    let mut rest = bytes;
    loop {
        let [a, b, c, d, behind @ ..] = rest else {
            return (frames, Ok(rest.len()));
        };
        let len = little_endian(&[*a, *b, *c, *d]);
        if len > 65_536 {
            return (frames, Err("frame-too-long"));
        }
        if len == 0 {
            return (frames, Err("malformed"));
        }
        if len > behind.len() as u64 {
            return (frames, Ok(rest.len()));
        }
        let (one, behind) = behind.split_at(len as usize);
        match body(one) {
            Ok(frame) => frames.push(frame),
            Err(violation) => return (frames, Err(violation)),
        }
        rest = behind;
    }
}

/// Decodes the body of a frame.
pub(crate) fn body(bytes: &[u8]) -> Read<Value> {
    if bytes.len() > 65_536 {
        return Err("frame-too-long");
    }
    let mut reader = Reader {
        bytes,
        at: 0,
        longer_than_needed: false,
    };
    let number = reader.number(32).map_err(|_| "unknown-frame")?;
    // A wrong encoding is reported before an illegal value.
    let mut wrong = None;
    let frame = match number {
        0 => json!({"HELLO": {
            "min_version": reader.number(16)?,
            "max_version": reader.number(16)?,
            "epoch": reader.number(64)?,
            "name": reader.name()?,
        }}),
        1 => {
            let offer = reader.number(64)?;
            let subject = reader.subject()?;
            let path = reader.path()?;
            let is_twice = |(at, hop): (usize, &Value)| {
                path[..at].iter().any(|it| it["gateway"] == hop["gateway"])
            };
            let count = path.len();
            if count == 0 || count > 8 || path.iter().enumerate().any(is_twice) {
                wrong = Some("bad-path");
            }
            if subject["topic"]["latched"].as_u64() > Some(1_024) {
                wrong = Some("bad-qos");
            }
            json!({"OFFER": {"offer": offer, "subject": subject, "path": path}})
        }
        2 => json!({"UNOFFER": {"offer": reader.number(64)?}}),
        3 => json!({"UNOFFERED": {"offer": reader.number(64)?}}),
        4 => {
            let (offer, depth) = (reader.number(64)?, reader.number(16)?);
            if depth == 0 || depth > 1_024 {
                wrong = Some("bad-qos");
            }
            json!({"WANT": {"offer": offer, "depth": depth}})
        }
        5 => json!({"UNWANT": {"offer": reader.number(64)?}}),
        6 => json!({"UNWANTED": {"offer": reader.number(64)?}}),
        7 => json!({"ASK": {
            "ask": reader.number(64)?,
            "kind": reader.variant(&["topic", "service"])?,
            "name": reader.name()?,
        }}),
        8 => json!({"ANSWER": {
            "ask": reader.number(64)?,
            "verdict": reader.variant(&["offered", "denied", "absent"])?,
        }}),
        _ => return Err("unknown-frame"),
    };
    if reader.at < bytes.len() {
        return Err("trailing-bytes");
    }
    if reader.longer_than_needed {
        return Err("not-canonical");
    }
    wrong.map_or(Ok(frame), Err)
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    longer_than_needed: bool,
}

impl<'a> Reader<'a> {
    fn take(&mut self, len: u64) -> Read<&'a [u8]> {
        if len > (self.bytes.len() - self.at) as u64 {
            return Err("malformed");
        }
        let from = self.at;
        self.at += len as usize;
        Ok(&self.bytes[from..self.at])
    }

    /// A varint: groups of seven bits, the lowest first. The highest bit is set in all but the last.
    fn number(&mut self, bits: u32) -> Read<u64> {
        let mut groups = Vec::new();
        loop {
            let byte = self.take(1)?[0];
            groups.push(byte & 0x7f);
            if byte & 0x80 == 0 {
                break;
            }
            if groups.len() as u32 == bits.div_ceil(7) {
                return Err("malformed");
            }
        }
        self.longer_than_needed |= groups.len() > 1 && groups.last() == Some(&0);
        let sum = |higher, group: &u8| higher * 128 + u128::from(*group);
        let value: u128 = groups.iter().rev().fold(0, sum);
        if value >> bits != 0 {
            return Err("malformed");
        }
        u64::try_from(value).map_err(|_| "malformed")
    }

    fn variant(&mut self, names: &[&'static str]) -> Read<&'static str> {
        let number = self.number(32)? as usize;
        names.get(number).copied().ok_or("malformed")
    }

    fn boolean(&mut self) -> Read<bool> {
        match self.take(1)? {
            [0] => Ok(false),
            [1] => Ok(true),
            _ => Err("malformed"),
        }
    }

    fn name(&mut self) -> Read<String> {
        let len = self.number(64)?;
        let text = self.take(len)?;
        let mut after_a_slash = true;
        for byte in text {
            match byte {
                b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-' => after_a_slash = false,
                b'/' if !after_a_slash => after_a_slash = true,
                _ => return Err("bad-name"),
            }
        }
        if after_a_slash || text.len() > 255 {
            return Err("bad-name");
        }
        Ok(text.iter().map(|byte| char::from(*byte)).collect())
    }

    fn data(&mut self) -> Read<Value> {
        Ok(json!({"name": self.name()?, "hash": self.number(64)?}))
    }

    fn subject(&mut self) -> Read<Value> {
        Ok(match self.number(32)? {
            0 => json!({"topic": {
                "name": self.name()?,
                "data": self.data()?,
                "reliable": self.boolean()?,
                "latched": self.number(16)?,
            }}),
            1 => json!({"service": {
                "name": self.name()?,
                "request": self.data()?,
                "reply": self.data()?,
            }}),
            _ => return Err("malformed"),
        })
    }

    fn path(&mut self) -> Read<Vec<Value>> {
        let mut path = Vec::new();
        for _ in 0..self.number(64)? {
            let gateway = hex(self.take(32)?);
            path.push(json!({"gateway": gateway, "epoch": self.number(64)?}));
        }
        Ok(path)
    }
}

/// Decodes the header of a payload.
pub(crate) fn header(bytes: &[u8; 40]) -> Read<Value> {
    let field = |at: usize| little_endian(&bytes[at..at + 8]);
    let (offer, len) = (field(8), field(32));
    if bytes[1..8] != [0; 7] {
        return Err("malformed");
    }
    let (header, has_payload) = match bytes[0] {
        1 => {
            let (sequence, age) = (field(16), field(24));
            let fields = json!({"offer": offer, "sequence": sequence, "age": age, "len": len});
            (json!({"message": fields}), true)
        }
        2 if field(16) == 0 => {
            let fields = json!({"offer": offer, "left": field(24), "len": len});
            (json!({"request": fields}), true)
        }
        3 if field(24) == 0 => {
            let (status, has_payload) = match field(16) {
                0 => ("ok", true),
                1 => ("failed", true),
                2 => ("cancelled", false),
                3 => ("deadline-passed", false),
                4 => ("unreachable", false),
                5 => ("denied", false),
                _ => return Err("malformed"),
            };
            let fields = json!({"offer": offer, "status": status, "len": len});
            (json!({"reply": fields}), has_payload)
        }
        _ => return Err("malformed"),
    };
    if len > 1 << 40 || (len > 0 && !has_payload) {
        return Err("bad-length");
    }
    Ok(header)
}

/// Decodes a beacon, or names the part that is wrong.
pub(crate) fn beacon(bytes: &[u8]) -> Read<Value> {
    if bytes.len() != 56 {
        return Err("length");
    }
    let (port, epoch) = (little_endian(&bytes[6..8]), little_endian(&bytes[40..48]));
    if &bytes[..4] != b"SM2G" {
        return Err("magic");
    }
    if bytes[4..6] != [1, 0] {
        return Err("version");
    }
    if port == 0 {
        return Err("port");
    }
    if bytes[48..] != [0; 8] {
        return Err("zeros");
    }
    Ok(json!({"port": port, "gateway": hex(&bytes[8..40]), "epoch": epoch}))
}

fn little_endian(bytes: &[u8]) -> u64 {
    let sum = |higher, byte: &u8| higher << 8 | u64::from(*byte);
    bytes.iter().rev().fold(0, sum)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
