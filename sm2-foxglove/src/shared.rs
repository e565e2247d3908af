use sm2_node::Node;

use crate::{access::Access, news::News, options::Options};

/// The part of a server that the threads of all viewers use.
pub(crate) struct Shared {
    pub(crate) node: Node,
    pub(crate) access: Access,
    pub(crate) options: Options,
    pub(crate) news: News,
    /// The name of the server, for people.
    pub(crate) name: String,
    /// The name of this run. A viewer that connects again compares it.
    pub(crate) session: String,
}
