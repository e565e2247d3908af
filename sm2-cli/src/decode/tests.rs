mod codec;
mod encode;
mod hostile;
mod plain;
mod postcard;
mod show;

use sm2_node::Message;
use sm2_proto::schema::Schema;

use crate::decode::Limits;

/// Keeps every element.
const ALL: usize = usize::MAX;

/// The limits of the screen, with everything on one line.
const LINE: Limits = Limits {
    width: usize::MAX,
    ..Limits::SCREEN
};

fn schema(text: &str) -> Schema {
    Schema::parse(text).unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn schema_of<T: Message + ?Sized>() -> Schema {
    schema(&T::schema().expect("a schema text"))
}
