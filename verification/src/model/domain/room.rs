//! A node that states for how many ends of links it has room.

use std::{collections::BTreeSet, rc::Rc};

use super::{
    super::{Failure, Property, fail},
    Fault, Scope,
    program::{End, Program},
};

impl Scope {
    /// The room of a node, if it states one.
    fn room(&self, at: usize) -> Option<usize> {
        self.max_links.filter(|_| at == 0).map(usize::from)
    }

    /// The room that a node states.
    pub(super) fn room_stated(&self, at: usize) -> Option<u32> {
        let overstated = u32::from(self.fault == Some(Fault::RoomOverstated));
        let room = u32::try_from(self.room(at)?).unwrap_or(u32::MAX);
        Some(room + overstated)
    }

    /// No node has more links than it has room for.
    //= SM2-LNK-007 model
    pub(super) fn check_room(&self, programs: &[Rc<Program>]) -> Result<(), Failure> {
        for (at, program) in programs.iter().enumerate() {
            if self.room(at).is_some_and(|room| program.links.len() > room) {
                let what = format!("node {at} has {} links", program.links.len());
                return fail(Property::WithinRoom, what);
            }
        }
        Ok(())
    }

    /// When all is quiet, a link waits only if one of its nodes has no room for it.
    //= SM2-LNK-007 model
    pub(super) fn check_waiting(
        &self,
        programs: &[Rc<Program>],
        waiting: &BTreeSet<[End; 2]>,
    ) -> Result<(), Failure> {
        let is_full = |end: &End| {
            let at = usize::from(end.0);
            self.room(at) == Some(programs[at].links.len())
        };
        for pair in waiting {
            if !pair.iter().any(is_full) {
                return fail(Property::WithinRoom, format!("{pair:?} waits for nothing"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::InterfaceId;

    use super::{super::World, *};

    /// Only the first node states a room, which is one link.
    #[test]
    fn a_link_waits_only_for_a_full_node() {
        let scope = Scope::named("room-3x1").unwrap();
        let full = World::new(&scope).unwrap();
        assert_eq!(full.programs[0].links.len(), 1);
        let mut empty = full.clone();
        empty.program(0).links.clear();
        let property = |world: &World, ends: [u8; 2]| {
            let pair = ends.map(|at| (at, 0, InterfaceId(1)));
            let checked = scope.check_waiting(&world.programs, &BTreeSet::from([pair]));
            checked.err().map(|it| it.property)
        };
        assert_eq!(property(&full, [0, 2]), None);
        assert_eq!(property(&full, [1, 2]), Some(Property::WithinRoom));
        assert_eq!(property(&empty, [0, 2]), Some(Property::WithinRoom));
    }
}
