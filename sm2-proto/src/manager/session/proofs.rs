//! Harnesses for one session.

use super::{Resumption, Session};
use crate::{
    Instant, Name,
    limits::LINKS_MAX,
    manager::{Credentials, node_record::NodeRecord},
};

/// A session may claim as many links as a node can have, and only until CLAIMED.
//= SM2-RES-003, SM2-RES-008 kani
// Shows MGR-QUOTA (BoundariesAndSamples), bound: any number of claims.
#[cfg_attr(kani, kani::proof)]
fn claims_are_bounded() {
    let credentials = Credentials {
        uid: 1,
        gid: 1,
        pid: 1,
    };
    let claims = kani::any_where(|claims: &usize| *claims < usize::MAX);
    let resuming = kani::any();
    let node = NodeRecord::new(credentials, Name::new("a").expect("a legal name"));
    let mut session = if resuming {
        let resumption = Resumption {
            claims,
            ..Resumption::default()
        };
        Session::Resuming { node, resumption }
    } else {
        Session::new(credentials)
    };
    assert_eq!(session.may_claim(), resuming && claims < LINKS_MAX);
    let until = Some(Instant(7));
    let mut session = session.claimed(until);
    assert_eq!(session.is_matching(), resuming);
    assert_eq!(session.claims_until(), until.filter(|_| resuming));
    if let Session::Ready { matching, .. } = &session {
        let ended = matching.as_ref().map(|it| it.ended.len());
        assert_eq!(ended, Some(0), "no pair was left out");
    }
    assert!(!session.may_claim(), "all is claimed");
    kani::cover!(resuming && claims == LINKS_MAX, "one too many");
    kani::cover!(resuming && claims < LINKS_MAX, "a claim");
}

#[cfg(test)]
kani::explored! {
    claims_are_bounded: 2,
}
