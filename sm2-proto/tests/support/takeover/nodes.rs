//! How nodes read their sockets, and how their drivers carry out the outputs.

use sm2_proto::control::{Changes, Page};
use sm2_proto::{
    Datagram, FdFacts, InterfaceId, LinkId, Machine,
    node::{self, End},
};

use super::{Down, Socket, World, end_of};

impl World {
    /// Feeds the next datagram to a node. Returns whether there was one.
    pub(crate) fn node_reads(&mut self, at: usize) -> bool {
        let Some(connection) = &mut self.programs[at].connection else {
            return false;
        };
        match connection.down.pop_front() {
            None => return false,
            Some(Down::Eof) => self.feed_node(at, node::Input::Eof, None),
            Some(Down::Frame(bytes, link)) => {
                let facts = link.map(|_| FdFacts::default());
                let datagram = Datagram {
                    fds: facts.as_slice(),
                    ..Datagram::new(&bytes)
                };
                self.feed_node(at, node::Input::Datagram(datagram), link);
            }
        }
        self.drained(at);
        true
    }

    pub(super) fn feed_node(&mut self, at: usize, input: node::Input<'_>, link: Option<LinkId>) {
        let taken = self.programs[at].node.handle(self.now, input);
        taken.unwrap_or_else(|error| panic!("{at}: {error}"));
        self.node_works(at, link);
    }

    /// `descriptor` came with the datagram just handled.
    pub(super) fn node_works(&mut self, at: usize, mut descriptor: Option<LinkId>) {
        while let Some(output) = self.programs[at].node.poll() {
            let program = &mut self.programs[at];
            match output {
                node::Output::Transmit(bytes) => {
                    let connection = program.connection.as_mut().expect("connected");
                    connection.up.push_back(bytes);
                }
                node::Output::Welcomed { .. } => {
                    (program.interfaces.values_mut()).for_each(|it| it.refused = false);
                }
                node::Output::Declared { interface, .. } => {
                    let ours = program.interfaces.get_mut(&interface).expect("declared");
                    assert!(!ours.answered, "one answer for each declaration");
                    ours.answered = true;
                }
                node::Output::DeclareRefused { interface, .. } => {
                    let ours = program.interfaces.get_mut(&interface).expect("declared");
                    if ours.answered {
                        ours.refused = true;
                        self.doom_underway(at, Some(interface));
                    } else {
                        program.interfaces.remove(&interface);
                    }
                }
                node::Output::Linked {
                    interface, link, ..
                } => {
                    assert_eq!(descriptor.take(), Some(link));
                    self.linked(at, interface, link);
                }
                node::Output::Unlink {
                    interface,
                    link,
                    code,
                } => {
                    assert!(self.pairs[&link].doomed, "{link} ended for nothing: {code}");
                    self.close_end(at, interface, link);
                }
                node::Output::Page(Page {
                    revision,
                    items,
                    next,
                }) => drop(program.mirror.page(revision, items, next).expect("sense")),
                node::Output::Changes(Changes {
                    revision,
                    changes,
                    more,
                }) => {
                    (program.mirror.changes(revision, changes, more)).expect("sense");
                }
                node::Output::Withdrawn { interface } => {
                    assert!(!program.interfaces.contains_key(&interface));
                }
                node::Output::Ended(end) => self.session_ended(at, end),
                node::Output::Resumed => {}
                other @ (node::Output::HelloRefused(_)
                | node::Output::LinkLost { .. }
                | node::Output::TransmitCounters(_)
                | node::Output::Inspected { .. }
                | node::Output::NotInspected { .. }
                | node::Output::Described { .. }
                | node::Output::Reloaded(_)) => panic!("{other:?} was not asked for"),
            }
        }
        // A LINK that crossed WITHDRAW: the driver closes the descriptor.
        if let Some(link) = descriptor {
            self.lose(at, link);
        }
    }

    /// The node's driver keeps its end of the socket pair.
    fn linked(&mut self, at: usize, interface: InterfaceId, link: LinkId) {
        self.programs[at].links.insert((interface, link));
        let pair = self.pairs.get_mut(&link).expect("made");
        pair.sockets[end_of(&pair.ends, at, interface)] = Socket::Held;
    }

    /// The node's driver closes the connection, and with it the descriptors that it did not read.
    fn session_ended(&mut self, at: usize, end: End) {
        assert!(!matches!(end, End::Violation(_) | End::Local(_)), "{end}");
        let connection = self.programs[at].connection.take().expect("connected");
        for down in &connection.down {
            if let Down::Frame(_, Some(link)) = down {
                self.lose(at, *link);
            }
        }
        if self.manager.is_some() {
            self.programs[at].closed.push_back(connection);
        }
    }
}
