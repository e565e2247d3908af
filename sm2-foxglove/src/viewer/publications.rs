//! The topics that a viewer publishes.

use std::{collections::HashMap, sync::Arc, time::Duration};

use sm2_node::Publisher;
use sm2_proto::{Name, TypeId, schema::Schema};
use sm2_ros_idl::{Set, TypeName};

use super::{End, Viewer};
use crate::{
    message_type::MessageType,
    protocol::{Level, Publication},
};

/// The reason for which a topic or message is not published, for people.
type Reason = Box<dyn std::error::Error + Send + Sync>;

/// The topics that a viewer publishes, by the numbers that it has given to them.
#[derive(Default)]
pub(super) struct Publications {
    known: HashMap<u32, Published>,
}

struct Published {
    publisher: Publisher<[u8]>,
    message_type: Arc<MessageType>,
    encoding: String,
}

impl Publications {
    pub(super) fn remove(&mut self, ids: &[u32]) {
        ids.iter().for_each(|id| drop(self.known.remove(id)));
    }
}

impl Viewer {
    /// Declares a publisher for the viewer.
    pub(super) fn advertise(&mut self, publication: &Publication) -> Result<(), End> {
        match self.publisher(publication) {
            Ok(published) => {
                self.publications.known.insert(publication.id, published);
                Ok(())
            }
            Err(error) => {
                let topic = &publication.topic;
                self.complain(Level::Error, format!("cannot publish {topic}: {error}"))
            }
        }
    }

    fn publisher(&self, publication: &Publication) -> Result<Published, Reason> {
        if !self.shared.options.allow_publish {
            return Err("sm2-foxglove runs without --allow-publish".into());
        }
        let topic = Name::typed(&publication.topic)?;
        let node = &self.shared.node;
        let known = self.snapshot.types.get(&topic).cloned();
        let (data, message_type) = match known {
            Some((data, message_type)) => {
                if publication.encoding == "cdr" && data.name.as_str() != publication.schema_name {
                    let given = &publication.schema_name;
                    return Err(format!("its type is {}, not {given}", data.name).into());
                }
                (data, message_type)
            }
            None => {
                let (data, text) = defined(publication)?;
                node.register_schema(data.clone(), &text)?;
                let message_type = MessageType::new(&data, Schema::parse(&text)?)?;
                (data, Arc::new(message_type))
            }
        };
        let builder = node.publisher_builder::<[u8]>(topic.as_str()).type_id(data);
        Ok(Published {
            // A subscriber without room misses the message: it must not delay the viewer's thread.
            publisher: builder.publish_timeout(Duration::ZERO).declare()?,
            message_type,
            encoding: publication.encoding.clone(),
        })
    }

    /// Publishes a message of the viewer.
    pub(super) fn publish(&mut self, id: u32, payload: &[u8]) -> Result<(), End> {
        let published = match self.publications.known.get(&id) {
            Some(published) => published.publish(payload),
            None => Err(format!("the channel {id} is not advertised").into()),
        };
        match published {
            Ok(()) => Ok(()),
            Err(error) => {
                let message = format!("a message was not published: {error}");
                self.complain(Level::Error, message)
            }
        }
    }
}

impl Published {
    fn publish(&self, payload: &[u8]) -> Result<(), Reason> {
        let message = self.message_type.to_domain(&self.encoding, payload)?;
        self.publisher.publish(&message)?;
        Ok(())
    }
}

/// The type of ROS 2 that a viewer defines, for a topic that no node of the domain knows, and its schema text.
fn defined(publication: &Publication) -> Result<(TypeId, String), Reason> {
    let definition = publication.schema.as_deref().filter(|it| !it.is_empty());
    let Some(definition) = definition.filter(|_| publication.encoding == "cdr") else {
        return Err(
            "no node publishes this topic or subscribes to it, so its type is not known".into(),
        );
    };
    let name: TypeName = publication.schema_name.parse()?;
    let text = Set::parse(&name, definition)?.schema_text(&name)?;
    let data = TypeId {
        name: Name::new(&publication.schema_name)?,
        hash: Schema::parse(&text)?.hash(),
    };
    Ok((data, text))
}
