//! The time limit for a domain whose lock is held, and which nobody serves.

use crate::common::TestDomain;
use sm2_io::DomainLock;
use sm2_manager::{Options, Standby, StartError};

#[test]
fn a_lock_whose_holder_does_not_serve_is_an_error() {
    let domain = TestDomain::new();
    let _lock = DomainLock::acquire(&domain.socket()).unwrap();
    let error = Standby::start(&domain.socket(), Options::default()).unwrap_err();
    assert!(
        matches!(error, StartError::NobodyServes { .. }),
        "{error:?}"
    );
}
