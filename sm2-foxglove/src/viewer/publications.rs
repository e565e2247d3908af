//! The topics that a viewer publishes.

use std::{collections::HashMap, sync::Arc, time::Duration};

use sm2_node::Publisher;
use sm2_proto::{Name, TypeId, schema::Schema};
use sm2_ros_idl::{Set, TypeName};

use super::context::{Context, End};
use crate::{
    message_type::MessageType,
    protocol::{Level, Publication},
};

/// The reason why a topic or message is not published, for people.
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

    /// Declares a publisher for the viewer.
    pub(super) fn add(
        &mut self,
        context: &mut Context,
        publication: &Publication,
    ) -> Result<(), End> {
        match publisher(context, publication) {
            Ok(published) => {
                self.known.insert(publication.id, published);
                Ok(())
            }
            Err(error) => {
                let topic = &publication.topic;
                context.complain(Level::Error, format!("cannot publish {topic}: {error}"))
            }
        }
    }

    /// Publishes a message of the viewer.
    pub(super) fn publish(
        &self,
        context: &mut Context,
        id: u32,
        payload: &[u8],
    ) -> Result<(), End> {
        let published = match self.known.get(&id) {
            Some(published) => published.publish(payload),
            None => Err(format!("the channel {id} is not advertised").into()),
        };
        match published {
            Ok(()) => Ok(()),
            Err(error) => {
                let message = format!("a message was not published: {error}");
                context.complain(Level::Error, message)
            }
        }
    }
}

/// Declares a publisher for a topic of the viewer.
fn publisher(context: &Context, publication: &Publication) -> Result<Published, Reason> {
    if !context.shared.options.allow_publish {
        return Err("sm2-foxglove runs without --allow-publish".into());
    }
    let topic = Name::typed(&publication.topic)?;
    let node = &context.shared.node;
    let known = context.snapshot.types.get(&topic).cloned();
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
