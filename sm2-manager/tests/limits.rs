//! Limits of programs that embed a Manager.

use crate::common::TestDomain;
use sm2_io::Listener;
use sm2_manager::{Limit, LimitError, Manager, Options, Standby, StartError};
use sm2_proto::control::Limits;

#[test]
fn a_manager_with_a_wrong_limit_does_not_start() {
    let domain = TestDomain::new();
    let options = Options {
        limits: Limits::default().with(Limit::SessionsPerUser, 0),
        ..Options::default()
    };
    let told = |error: StartError| match error {
        StartError::Limit(error) => error,
        error => panic!("{error}"),
    };
    let refused = LimitError::OutOfRange {
        limit: Limit::SessionsPerUser,
        value: 0,
    };
    let socket = domain.socket();
    let bound = Manager::bind(&socket, options.clone()).map(drop);
    assert_eq!(told(bound.unwrap_err()), refused);
    let standby = Standby::start(&socket, options.clone()).map(drop);
    assert_eq!(told(standby.unwrap_err()), refused);
    assert!(!socket.exists(), "the domain is not claimed");
    let listener = Listener::bind(&socket, 16).unwrap();
    let adopted = Manager::adopt(listener.into(), options).map(drop);
    assert_eq!(told(adopted.unwrap_err()), refused);
}
