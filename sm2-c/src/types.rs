//! The types of messages: a name and a schema, or bytes.

use std::borrow::Cow;
use std::ffi::c_char;
use std::fmt::Write as _;
use std::mem::MaybeUninit;

use sm2_node::{DeclareError, Name, TypeId};
use sm2_proto::schema::Schema;

use crate::arguments::{In, Text, given, sized};
use crate::status::{Failure, Status, guard};

/// The type of a topic's messages, of requests or of replies. Two programs can communicate if name and schema are the
/// same in both. A call that takes a type takes NULL for raw bytes.
#[repr(C)]
#[derive(Debug)]
pub struct Type {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// The name, such as `sensor/Imu`: segments of `A-Z a-z 0-9 _ -`, joined by single `/`.
    pub name: *const c_char,
    /// The schema text, such as `plain:struct{stamp_ns:u64,gyro:array[f64;0000000000000003],}`: Annex A of SPEC.md
    /// defines it. Tools decode messages with it. NULL if only the hash is known.
    pub schema: *const c_char,
    /// The hash of the schema. Used only if `schema` is NULL.
    pub hash: u64,
}

sized! { Type, hash: u64 = "sm2_type_t"; }

/// A type that was read from the program's struct, with its schema text.
#[derive(Debug)]
pub(crate) struct Declared {
    pub(crate) id: TypeId,
    text: Option<String>,
}

impl Declared {
    /// Reads a type; `None` for NULL, which stands for bytes.
    pub(crate) fn read(given: *const Type) -> Result<Option<Self>, Failure> {
        let zero = || Type {
            size: size_of::<Type>(),
            name: std::ptr::null(),
            schema: std::ptr::null(),
            hash: 0,
        };
        let Some(given) = In(given).read(zero)? else {
            return Ok(None);
        };
        let name = Name::typed(Text(given.name).required("name of the type")?)?;
        let text = Text(given.schema);
        let text = text.optional("schema")?;
        let hash = match text {
            Some(text) => Schema::parse(text)?.hash(),
            None => given.hash,
        };
        Ok(Some(Self {
            id: TypeId { name, hash },
            text: text.map(str::to_owned),
        }))
    }

    /// Registers the schema text, so that tools and other programs can read it.
    pub(crate) fn register(&self, node: &sm2_node::Node) -> Result<(), Failure> {
        match &self.text {
            Some(text) => Ok(node.register_schema(self.id.clone(), text)?),
            None => Ok(()),
        }
    }
}

/// The types of requests and replies; `None` if both are bytes. Registers their schema texts.
pub(crate) fn service_types(
    node: &sm2_node::Node,
    request: *const Type,
    reply: *const Type,
) -> Result<Option<(TypeId, TypeId)>, Failure> {
    match (Declared::read(request)?, Declared::read(reply)?) {
        (None, None) => Ok(None),
        (Some(request), Some(reply)) => {
            request.register(node)?;
            reply.register(node)?;
            Ok(Some((request.id, reply.id)))
        }
        _ => Err(Failure::misuse(
            "one of the types of a service is NULL: pass both, or NULL for both to use bytes",
        )),
    }
}

/// The failure of a declaration. If types do not fit, its text ends with the schemas of both, as far as the domain
/// knows them.
pub(crate) fn not_declared(node: &sm2_node::Node, error: DeclareError) -> Failure {
    let pairs = match &error {
        DeclareError::TypeMismatch { ours, theirs, .. } => vec![(ours, theirs)],
        DeclareError::ServiceMismatch { ours, theirs, .. } => {
            vec![(&ours.0, &theirs.0), (&ours.1, &theirs.1)]
        }
        _ => Vec::new(),
    };
    let mut schemas = String::new();
    for (ours, theirs) in pairs.into_iter().filter(|(ours, theirs)| ours != theirs) {
        for (whose, data) in [("here", ours), ("there", theirs)] {
            let text = node.describe(data).ok().flatten();
            let text = text.map_or(Cow::Borrowed("no schema text"), Cow::Owned);
            let _ = write!(schemas, "\n{whose}: {data}: {text}");
        }
    }
    let mut failure = Failure::from(error);
    failure.text.to_mut().push_str(&schemas);
    failure
}

/// Stores the hash of a schema text in `hash`.
///
/// Errors: `SM2_BAD_SCHEMA`, `SM2_MISUSE`.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_schema_hash(
    schema: *const c_char,
    hash: Option<&mut MaybeUninit<u64>>,
) -> Status {
    guard(|| {
        let schema = Schema::parse(Text(schema).required("schema")?)?;
        given(hash, "hash")?.write(schema.hash());
        Ok(())
    })
}
