//! All processes of the run.

use sm2_tests::domain::TempDomain;

use crate::{
    child::Broken, fleet::Fleet, gateways::Gateways, inspector::Inspector, managers::Managers,
    report::Report,
};

/// Everything that runs.
pub(crate) struct World {
    /// Those of the near and of the far domain.
    pub(crate) managers: [Managers; 2],
    pub(crate) fleet: Fleet,
    pub(crate) gateways: Gateways,
    pub(crate) inspector: Inspector,
    /// How many rests there were.
    pub(crate) rests: usize,
}

impl World {
    pub(crate) fn start(domains: &[TempDomain; 2], report: &mut Report) -> Result<Self, Broken> {
        let [near, far] = domains.each_ref().map(TempDomain::socket);
        let sockets = [&*near, &*far];
        let managers = [
            Managers::start(sockets[0], report)?,
            Managers::start(sockets[1], report)?,
        ];
        Ok(Self {
            managers,
            fleet: Fleet::start(sockets, report)?,
            gateways: Gateways::start(sockets),
            inspector: Inspector::new(sockets),
            rests: 0,
        })
    }

    /// The gateway that may be killed before the next rest.
    pub(crate) const fn mortal_gateway(&self) -> usize {
        self.rests % 2
    }

    /// Reads what all processes say, ends stops and shortages, and finds processes that ended by themselves.
    pub(crate) fn look(&mut self, report: &mut Report) -> Result<(), Broken> {
        for managers in &mut self.managers {
            managers.look(report)?;
        }
        self.gateways.look(report)?;
        self.fleet.look(report)
    }

    pub(crate) fn end(self, report: &mut Report) {
        drop((self.fleet, self.inspector));
        self.gateways.end(report);
        for managers in self.managers {
            managers.end(report);
        }
    }
}
