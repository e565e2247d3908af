//! A second decoder of control frames, written from SPEC section 3 alone: by hand, one byte after the other. It takes
//! the fields of plain structures from the table in SPEC. It returns the meaning of a frame as JSON, or the name of the
//! violation.

use serde_json::{Value, json};

const SPEC: &str = include_str!("../../../SPEC.md");

type Read<T> = Result<T, &'static str>;

pub(crate) fn to_manager(bytes: &[u8], fds: usize, some_lost: bool) -> Read<Value> {
    frame(bytes, (fds, some_lost), |reader, number| {
        let meaning = match number {
            0 => json!({"Hello": {
                "min_version": reader.u16()?,
                "max_version": reader.u16()?,
                "name": reader.name()?,
                "resuming": reader.bool()?,
            }}),
            1 => json!({"Declare": {
                "interface": reader.u64()?,
                "contract": reader.contract()?,
            }}),
            2 => json!({"Withdraw": {"interface": reader.u64()?}}),
            3 => json!({"Unlinked": {
                "interface": reader.u64()?,
                "link": reader.link_id()?,
                "code": reader.u16()?,
            }}),
            4 => json!({"Query": {"after": reader.option(Reader::key)?}}),
            5 => json!({"Goodbye": {"code": reader.u16()?}}),
            6 => json!({"Claim": {
                "interface": reader.u64()?,
                "link": reader.link_id()?,
                "key": reader.u64()?,
                "version": reader.u16()?,
                "reliable": reader.bool()?,
                "sealed": reader.bool()?,
            }}),
            7 => json!("Claimed"),
            8 => json!({"Watch": {"after": reader.u64()?}}),
            9 => return Ok(Some((json!("Counters"), 1))),
            10 => json!({"Inspect": {"node": reader.u64()?}}),
            11 => json!({"Schema": {"data": reader.type_id()?, "text": reader.schema()?}}),
            12 => json!({"Describe": {"data": reader.type_id()?}}),
            13 => json!({"MaxLinks": {"max_links": reader.u32()?}}),
            14 => json!("Reload"),
            15 => json!({"Suspended": {"interface": reader.u64()?}}),
            _ => return Ok(None),
        };
        Ok(Some((meaning, 0)))
    })
}

pub(crate) fn to_node(bytes: &[u8], fds: usize, some_lost: bool) -> Read<Value> {
    frame(bytes, (fds, some_lost), |reader, number| {
        let meaning = match number {
            0 => json!({"Welcome": {
                "version": reader.u16()?,
                "epoch": reader.u64()?,
                "node": reader.u64()?,
            }}),
            1 => json!({"HelloRefused": {"reason": reader.refusal()?}}),
            2 => json!({"Declared": {"interface": reader.u64()?, "matches": reader.u32()?}}),
            3 => json!({"DeclareRefused": {
                "interface": reader.u64()?,
                "reason": reader.refusal()?,
            }}),
            4 => {
                let meaning = json!({"Link": {
                    "interface": reader.u64()?,
                    "link": reader.link_id()?,
                    "key": reader.u64()?,
                    "version": reader.u16()?,
                    "reliable": reader.bool()?,
                    "sealed": reader.bool()?,
                    "peer": {
                        "node": reader.u64()?,
                        "name": reader.name()?,
                        "interface": reader.u64()?,
                        "contract": reader.contract()?,
                    },
                }});
                return Ok(Some((meaning, 1)));
            }
            5 => json!({"Unlink": {
                "interface": reader.u64()?,
                "link": reader.link_id()?,
                "code": reader.u16()?,
            }}),
            6 => json!({"Withdrawn": {"interface": reader.u64()?}}),
            7 => {
                let revision = reader.u64()?;
                let mut items = Vec::new();
                for _ in 0..reader.u64()? {
                    items.push(reader.item()?);
                }
                let next = reader.option(Reader::key)?;
                json!({"Page": {"revision": revision, "items": items, "next": next}})
            }
            8 => json!({"Goodbye": {"code": reader.u16()?}}),
            9 => json!({"Changes": {
                "revision": reader.u64()?,
                "changes": reader.option(Reader::changes)?,
                "more": reader.bool()?,
            }}),
            10 => {
                let meaning = json!({"Inspected": {"node": reader.u64()?}});
                return Ok(Some((meaning, 1)));
            }
            11 => json!({"NotInspected": {"node": reader.u64()?}}),
            12 => json!({"Described": {
                "data": reader.type_id()?,
                "text": reader.option(Reader::schema)?,
            }}),
            13 => json!("CountersLost"),
            14 => json!({"Reloaded": {"outcome": reader.reload_outcome()?}}),
            _ => return Ok(None),
        };
        Ok(Some((meaning, 0)))
    })
}

/// `body` reads a frame of a known number. `fds` is the number of descriptors that came with the
/// frame; `some_lost`: the receiver had no room for further ones.
fn frame(
    bytes: &[u8],
    (fds, some_lost): (usize, bool),
    body: impl Fn(&mut Reader<'_>, u32) -> Read<Option<(Value, usize)>>,
) -> Read<Value> {
    if bytes.len() > 65_536 {
        return Err("frame-too-long");
    }
    let mut reader = Reader {
        rest: bytes,
        longer_than_needed: false,
        bad_qos: false,
        bad_schema: false,
    };
    let number = reader.u32().map_err(|_| "unknown-frame")?;
    let (meaning, fds_expected) = body(&mut reader, number)?.ok_or("unknown-frame")?;
    if !reader.rest.is_empty() {
        return Err("trailing-bytes");
    }
    if reader.longer_than_needed {
        return Err("not-canonical");
    }
    if reader.bad_qos {
        return Err("bad-qos");
    }
    if reader.bad_schema {
        return Err("bad-schema");
    }
    let as_expected = if some_lost {
        fds < fds_expected
    } else {
        fds == fds_expected
    };
    if !as_expected {
        return Err("fd-count");
    }
    Ok(meaning)
}

struct Reader<'a> {
    rest: &'a [u8],
    longer_than_needed: bool,
    bad_qos: bool,
    bad_schema: bool,
}

impl Reader<'_> {
    fn byte(&mut self) -> Read<u8> {
        let (&byte, rest) = self.rest.split_first().ok_or("malformed")?;
        self.rest = rest;
        Ok(byte)
    }

    fn varint(&mut self, bits: u32) -> Read<u64> {
        let mut value = 0_u128;
        for group in 0..bits.div_ceil(7) {
            let byte = self.byte()?;
            value |= u128::from(byte & 0x7f) << (7 * group);
            if byte < 0x80 {
                // Only the number 0 may end in a group of zeros.
                self.longer_than_needed |= byte == 0 && group > 0;
                let fits = value < 1 << bits;
                let value = u64::try_from(value).map_err(|_| "malformed")?;
                return if fits { Ok(value) } else { Err("malformed") };
            }
        }
        Err("malformed")
    }

    fn u16(&mut self) -> Read<u16> {
        Ok(self.varint(16)? as u16)
    }

    fn u32(&mut self) -> Read<u32> {
        Ok(self.varint(32)? as u32)
    }

    fn u64(&mut self) -> Read<u64> {
        self.varint(64)
    }

    fn i32(&mut self) -> Read<i32> {
        let zigzag = self.u32()?;
        let half = (zigzag / 2) as i32;
        Ok(if zigzag % 2 == 0 { half } else { -half - 1 })
    }

    fn bool(&mut self) -> Read<bool> {
        match self.byte()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err("malformed"),
        }
    }

    fn option<T>(&mut self, read: impl Fn(&mut Self) -> Read<T>) -> Read<Option<T>> {
        match self.byte()? {
            0 => Ok(None),
            1 => Ok(Some(read(self)?)),
            _ => Err("malformed"),
        }
    }

    fn name(&mut self) -> Read<String> {
        let len = self.u64()?;
        if len > self.rest.len() as u64 {
            return Err("malformed");
        }
        let (text, rest) = self.rest.split_at(len as usize);
        self.rest = rest;
        let segment = |segment: &[u8]| {
            let legal =
                |byte: &u8| matches!(byte, b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
            !segment.is_empty() && segment.iter().all(legal)
        };
        if text.len() > 255 || !text.split(|&byte| byte == b'/').all(segment) {
            return Err("bad-name");
        }
        Ok(text.iter().map(|&byte| char::from(byte)).collect())
    }

    fn type_id(&mut self) -> Read<Value> {
        Ok(json!({"name": self.name()?, "hash": self.u64()?}))
    }

    fn link_id(&mut self) -> Read<Value> {
        Ok(json!({"epoch": self.u64()?, "serial": self.u64()?}))
    }

    fn entity(&mut self) -> Read<Value> {
        Ok(json!({"node": self.u64()?, "interface": self.u64()?}))
    }

    fn key(&mut self) -> Read<Value> {
        Ok(match self.u32()? {
            0 => json!("Domain"),
            1 => json!({"Member": {"entity": self.entity()?}}),
            2 => json!({"Link": {"link": self.link_id()?, "offering": self.entity()?}}),
            3 => json!({"Claim": {"link": self.link_id()?, "entity": self.entity()?}}),
            4 => json!({"Unlinked": {"offering": self.entity()?, "demanding": self.entity()?}}),
            _ => return Err("malformed"),
        })
    }

    fn changes(&mut self) -> Read<Value> {
        let mut changes = Vec::new();
        for _ in 0..self.u64()? {
            changes.push(match self.u32()? {
                0 => json!({"Set": {"item": self.item()?}}),
                1 => json!({"Removed": {"key": self.key()?}}),
                _ => return Err("malformed"),
            });
        }
        Ok(Value::Array(changes))
    }

    fn schema(&mut self) -> Read<String> {
        let text = self.text()?;
        self.bad_schema |= text.len() > 32_768;
        Ok(text)
    }

    fn text(&mut self) -> Read<String> {
        let len = self.u64()?;
        if len > self.rest.len() as u64 {
            return Err("malformed");
        }
        let (text, rest) = self.rest.split_at(len as usize);
        self.rest = rest;
        // SPEC has no other name for bytes that are not text.
        String::from_utf8(text.to_vec()).map_err(|_| "bad-name")
    }

    fn reload_outcome(&mut self) -> Read<Value> {
        Ok(match self.u32()? {
            0 => json!("Applied"),
            1 => json!("NoPolicy"),
            2 => json!("NotPermitted"),
            3 => json!({"Unusable": {"problem": self.policy_problem()?, "text": self.text()?}}),
            _ => return Err("malformed"),
        })
    }

    fn policy_problem(&mut self) -> Read<&'static str> {
        Ok(match self.u32()? {
            0 => "Unreadable",
            1 => "NotTrusted",
            2 => "Invalid",
            _ => return Err("malformed"),
        })
    }

    /// `depth` and `max_borrowed` are at least 1; `latched` may be 0.
    fn qos(&mut self, least: u16) -> Read<u16> {
        let value = self.u16()?;
        self.bad_qos |= value < least || value > 1_024;
        Ok(value)
    }

    /// A structure of numbers and flags, with the fields that the table in SPEC gives it.
    fn structure(&mut self, name: &str) -> Read<Value> {
        let row = format!("| `{name}` | `");
        let mut rows = SPEC.lines().filter_map(|it| it.strip_prefix(&row));
        let fields = rows.next().expect("a row").trim_end_matches("` |");
        let mut value = serde_json::Map::new();
        for field in fields.split(", ") {
            let (name, kind) = field.split_once(": ").expect("a name and a type");
            let read = match (name, kind) {
                ("depth" | "max_borrowed", "u16") => self.qos(1)?.into(),
                ("latched", "u16") => self.qos(0)?.into(),
                (_, "bool") => self.bool()?.into(),
                (_, "u8") => self.byte()?.into(),
                (_, "u32") => self.u32()?.into(),
                (_, "u64") => self.u64()?.into(),
                (_, "Name") => self.name()?.into(),
                other => panic!("{other:?}"),
            };
            value.insert(name.to_owned(), read);
        }
        Ok(value.into())
    }

    fn limits(&mut self) -> Read<Vec<Value>> {
        let count = self.u64()?;
        (0..count).map(|_| self.structure("StatedLimit")).collect()
    }

    fn contract(&mut self) -> Read<Value> {
        Ok(match self.u32()? {
            0 => json!({"Publisher": {
                "topic": self.name()?,
                "data": self.type_id()?,
                "offer": self.structure("OfferedQos")?,
            }}),
            1 => json!({"Subscriber": {
                "topic": self.name()?,
                "data": self.option(Self::type_id)?,
                "demand": self.structure("DemandedQos")?,
            }}),
            2 => json!({"Server": {
                "service": self.name()?,
                "request": self.type_id()?,
                "reply": self.type_id()?,
                "qos": self.structure("ServiceQos")?,
            }}),
            3 => json!({"Client": {
                "service": self.name()?,
                "types": self.option(|it| Ok([it.type_id()?, it.type_id()?]))?,
                "qos": self.structure("ServiceQos")?,
            }}),
            _ => return Err("malformed"),
        })
    }

    fn refusal(&mut self) -> Read<Value> {
        Ok(match self.u32()? {
            0 => json!("NameTaken"),
            1 => json!({"Version": {"min": self.u16()?, "max": self.u16()?}}),
            2 => json!({"TopicType": {"theirs": self.type_id()?}}),
            3 => json!({"ServiceType": {
                "request": self.type_id()?,
                "reply": self.type_id()?,
            }}),
            4 => json!({"Quota": {"quota": self.quota()?, "limit": self.u32()?}}),
            5 => json!({"Denied": {"rule": self.option(Self::name)?}}),
            6 => json!({"Exclusive": {"rule": self.name()?}}),
            _ => return Err("malformed"),
        })
    }

    fn quota(&mut self) -> Read<&'static str> {
        Ok(match self.u32()? {
            0 => "SessionsPerUser",
            1 => "InterfacesPerSession",
            2 => "InterfacesPerUser",
            3 => "LinksPerSession",
            4 => "SessionsPerProcess",
            5 => "InterfacesPerProcess",
            _ => return Err("malformed"),
        })
    }

    fn item(&mut self) -> Read<Value> {
        Ok(match self.u32()? {
            0 => json!({"Domain": {"limits": {
                "limits": self.limits()?,
                "seal_all": self.bool()?,
                "waive_user_boundary": self.bool()?,
            }}}),
            1 => json!({"Node": {
                "node": self.u64()?,
                "name": self.name()?,
                "uid": self.u32()?,
                "pid": self.i32()?,
                "resuming": self.bool()?,
                "max_links": self.option(Reader::u32)?,
            }}),
            2 => json!({"Interface": {
                "entity": self.entity()?,
                "contract": self.contract()?,
            }}),
            3 => json!({"Refusal": {
                "entity": self.entity()?,
                "contract": self.contract()?,
                "reason": self.refusal()?,
            }}),
            4 => json!({"Link": {
                "link": self.link_id()?,
                "offering": self.entity()?,
                "demanding": self.entity()?,
                "version": self.u16()?,
                "reliable": self.bool()?,
                "sealed": self.bool()?,
            }}),
            5 => json!({"Claim": {"link": self.link_id()?, "entity": self.entity()?}}),
            6 => json!({"Unlinked": {
                "offering": self.entity()?,
                "demanding": self.entity()?,
                "reason": self.unlinked_reason()?,
            }}),
            7 => json!({"Waiting": {
                "link": self.link_id()?,
                "offering": self.entity()?,
                "demanding": self.entity()?,
            }}),
            _ => return Err("malformed"),
        })
    }

    fn unlinked_reason(&mut self) -> Read<Value> {
        Ok(match self.u32()? {
            0 => json!({"Ended": {"code": self.u16()?}}),
            1 => json!({"Quota": {"node": self.u64()?, "limit": self.u32()?}}),
            2 => json!("Descriptors"),
            _ => return Err("malformed"),
        })
    }
}
