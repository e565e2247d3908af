//! Types of ROS 2 that are known at compile time. `sm2-ros-build` generates the implementations of these traits.

use crate::DecodeError;
use crate::cdr::{Cdr, Reader};

/// A message of ROS 2, or a part of a service or action.
pub trait Type:
    Cdr + Clone + std::fmt::Debug + Default + PartialEq + Send + Sync + 'static
{
    /// Its name, such as `sensor_msgs/msg/Image`.
    const TYPE_NAME: &'static str;
    /// Its RIHS01 hash: ROS 2 compares types by it.
    const RIHS01: [u8; 32];
    /// Its schema text in SM2's encoding `cdr` (SPEC Annex A): the hash and the definition.
    const SCHEMA: &'static str;
}

/// A type whose messages can be read in place: [`view`] decodes one without a copy of its number sequences, which are
/// the long part of images and point clouds.
///
/// A subscriber for bytes of this type has them where their publisher put them:
/// `node.subscriber_builder::<[u8]>("camera").type_id(Image::type_id())`. Texts and other fields are copied, so a
/// publisher that breaks the rules and changes a message can only change numbers.
pub trait Viewed: Type {
    /// The structure with the same fields, where a sequence of numbers is a [`Numbers`](crate::cdr::Numbers). A type
    /// without such a sequence is its own view.
    type View<'a>: std::fmt::Debug + Clone;

    /// Reads the fields.
    ///
    /// # Errors
    ///
    /// As [`Cdr::read`].
    fn view<'a>(reader: &mut Reader<&'a [u8]>) -> Result<Self::View<'a>, DecodeError>;
}

/// Decodes a message without a copy of its number sequences: see [`Viewed`].
///
/// ```
/// # #[cfg(feature = "common-interfaces")] {
/// use sm2_ros::cdr::to_vec;
/// use sm2_ros::sensor_msgs::msg::Image;
/// use sm2_ros::view;
///
/// let bytes = to_vec(&Image { data: vec![7; 640], ..Image::default() })?;
/// let image = view::<Image>(&bytes)?;
/// assert_eq!(image.data.as_slice(), Some(&[7; 640][..]));
/// # }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
///
/// [`DecodeError::Value`] with the path to the field whose bytes are wrong.
pub fn view<T: Viewed>(bytes: &[u8]) -> Result<T::View<'_>, DecodeError> {
    let mut reader = Reader::new(bytes)?;
    let view = T::view(&mut reader)?;
    reader.end()?;
    Ok(view)
}

/// Visits types, each with its Rust type: see `for_each_type` in the generated file.
pub trait TypeVisitor {
    /// Visits one type.
    fn visit<T: Viewed>(&mut self);
}

/// A service of ROS 2: the type of its requests, and that of its replies.
#[cfg(not(feature = "messages"))]
pub trait Service {
    /// Its name, such as `std_srvs/srv/SetBool`.
    const NAME: &'static str;
    /// A request.
    type Request: Type;
    /// A reply.
    type Response: Type;
    /// The report of a call, for tools that watch services.
    type Event: Type;
}

/// A service of ROS 2: the type of its requests, and that of its replies.
#[cfg(feature = "messages")]
pub trait Service {
    /// Its name, such as `std_srvs/srv/SetBool`.
    const NAME: &'static str;
    /// A request.
    type Request: Type + sm2_node::Message;
    /// A reply.
    type Response: Type + sm2_node::Message;
    /// The report of a call, for tools that watch services.
    type Event: Type + sm2_node::Message;

    /// Declares a client of the service `service`: [`Node::client`](sm2_node::Node::client) with the types of this
    /// service.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`](sm2_node::DeclareError).
    fn client(node: &sm2_node::Node, service: &str) -> Result<Client<Self>, sm2_node::DeclareError>
    where
        Self: Sized,
    {
        node.client(service)
    }

    /// Declares a server of the service `service`: [`Node::server`](sm2_node::Node::server) with the types of this
    /// service.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`](sm2_node::DeclareError).
    fn server(node: &sm2_node::Node, service: &str) -> Result<Server<Self>, sm2_node::DeclareError>
    where
        Self: Sized,
    {
        node.server(service)
    }
}

/// A client of a service of ROS 2.
#[cfg(feature = "messages")]
pub type Client<S> = sm2_node::Client<<S as Service>::Request, <S as Service>::Response>;

/// A server of a service of ROS 2.
#[cfg(feature = "messages")]
pub type Server<S> = sm2_node::Server<<S as Service>::Request, <S as Service>::Response>;

/// An action of ROS 2. SM2 has no actions; the parts of one can be sent by services and topics.
pub trait Action {
    /// Its name, such as `example_interfaces/action/Fibonacci`.
    const NAME: &'static str;
    /// The goal.
    type Goal: Type;
    /// The result.
    type Result: Type;
    /// The feedback about a goal.
    type Feedback: Type;
    /// The feedback with the id of its goal.
    type FeedbackMessage: Type;
    /// The service that accepts or refuses a goal.
    type SendGoal: Service;
    /// The service that returns the result.
    type GetResult: Service;
}
