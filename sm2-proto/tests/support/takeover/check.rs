use sm2_proto::{
    Contract, EntityId, InterfaceId, LinkId,
    control::UnlinkedReason,
    domain::{Ask, Domain},
    match_contracts, node,
};

use super::{Pair, Socket, World};

impl World {
    /// The checks that hold when all is quiet.
    pub(crate) fn check(&mut self) {
        let domain = self.look();
        let entities: Vec<_> = self.entities();
        assert_eq!(
            domain
                .interfaces()
                .filter(|it| it.refused.is_none())
                .count(),
            entities.len()
        );
        assert_eq!(domain.claims().count(), 0, "all claims met or gave up");
        let mut shown = 0;
        for (link, pair) in self.held() {
            assert_eq!(pair.sockets, [Socket::Held; 2], "{link}");
            // A link whose two interfaces were refused stays open, and is not claimed
            // (SM2-RES-010).
            let granted = |end| entities.iter().any(|it| it.end == end);
            let [one, other] = pair.ends.map(granted);
            assert_eq!(one, other, "{link} has no claim of one end");
            shown += usize::from(one);
        }
        assert_eq!(domain.links().count(), shown);
        for (link, pair) in &self.pairs {
            let gone = pair.sockets == [Socket::Closed; 2];
            assert!(!gone || pair.doomed, "{link} was lost for nothing");
        }
        for one in &entities {
            for other in &entities {
                self.check_pair(&domain, one, other);
            }
        }
    }

    fn check_pair(&self, domain: &Domain, one: &Granted, other: &Granted) {
        let ends = [one.end, other.end];
        let same = |pair: &Pair| pair.ends == ends || pair.ends == [ends[1], ends[0]];
        let links: Vec<_> = self.held().filter(|(_, pair)| same(pair)).collect();
        let matches = match_contracts(&one.contract, &other.contract).is_ok();
        let pair = (one.entity, other.entity);
        let mut shown = domain.links_of(one.entity).filter(|it| {
            [(it.offering, it.demanding), (it.demanding, it.offering)].contains(&pair)
        });
        let unlinked = domain
            .unlinked_reason(pair.0, pair.1)
            .or_else(|| domain.unlinked_reason(pair.1, pair.0));
        match (&links[..], shown.next()) {
            ([(id, _)], Some(link)) => {
                assert_eq!(**id, link.link);
                assert!(matches, "{pair:?}");
            }
            ([], None) if matches => {
                assert!(
                    matches!(unlinked, Some(UnlinkedReason::Ended { .. })),
                    "{pair:?}: {unlinked:?}"
                );
                let mut ends = ends;
                ends.sort_unstable();
                assert!(self.broken.contains(&ends), "{pair:?}");
            }
            ([], None) => {}
            (links, shown) => panic!("{links:?}: {shown:?}"),
        }
    }

    fn held(&self) -> impl Iterator<Item = (&LinkId, &Pair)> {
        let held = |(_, pair): &(&LinkId, &Pair)| pair.sockets.contains(&Socket::Held);
        self.pairs.iter().filter(held)
    }

    /// The interfaces that the present Manager has granted.
    fn entities(&self) -> Vec<Granted> {
        let mut entities = Vec::new();
        for (at, program) in self.programs.iter().enumerate() {
            let node = program.node.id().expect("all is quiet");
            for (&interface, ours) in &program.interfaces {
                assert!(ours.answered, "all is quiet");
                if !ours.refused {
                    entities.push(Granted {
                        end: (at, interface),
                        entity: EntityId { node, interface },
                        contract: ours.contract.clone(),
                    });
                }
            }
        }
        entities
    }

    /// The domain as the first node reads it.
    //= SM2-WCH-003 model
    fn look(&mut self) -> Domain {
        self.programs[0].mirror.restart();
        while let Some(ask) = self.programs[0].mirror.ask() {
            let input = match ask {
                Ask::Page { after } => node::Input::Query { after },
                Ask::Changes { after } => node::Input::Watch { after },
            };
            self.feed_node(0, input, None);
            self.be_quiet();
        }
        self.programs[0].mirror.domain().clone()
    }
}

struct Granted {
    end: (usize, InterfaceId),
    entity: EntityId,
    contract: Contract,
}
