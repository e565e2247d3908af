//! Parameters: how nodes declare, read, watch and set them.

use std::fs;
use std::time::Duration;

use sm2_node::params::limits::TABLE_MAX;
use sm2_node::params::{
    Assignment, Changes, Origin, ParametersError, SetError, SetParameters, SetParametersResult,
    Table, Value,
};
use sm2_node::{
    CallError, Client, Executor, Message, Node, Parameter, Parameters, Subscriber, WaitSet,
};

use crate::common::fixture::Fixture;
use crate::common::wait::next as next_ready;
use crate::common::{Domain, SOON, next, until};

type SetClient = Client<SetParameters, SetParametersResult>;

/// A node that reads and sets the parameters of `lidar`.
struct Operator {
    tables: Subscriber<Table>,
    client: SetClient,
}

impl Operator {
    fn new(node: &Node) -> Self {
        let client: SetClient = node.client("parameters/lidar").unwrap();
        client.wait_for_servers_timeout(1, SOON).unwrap();
        Self {
            tables: node.subscriber("parameters/lidar").unwrap(),
            client,
        }
    }

    fn set(&self, values: &[(&str, Value)]) -> SetParametersResult {
        let request = request(values);
        (*self.client.call_timeout(&request, SOON).unwrap()).clone()
    }
}

/// A node with a background thread in every mode of these tests: no test calls each of its nodes regularly.
fn driven(domain: &Domain, name: &str) -> Node {
    domain.builder(name).background(true).connect().unwrap()
}

fn request(values: &[(&str, Value)]) -> SetParameters {
    let assignment = |(name, value): &(&str, Value)| Assignment {
        name: (*name).to_owned(),
        value: value.clone(),
    };
    SetParameters {
        parameters: values.iter().map(assignment).collect(),
    }
}

/// The parameters `min` and `max`.
fn declare(node: &Node) -> (Parameter<f64>, Parameter<f64>, Parameters) {
    let mut builder = node.parameters_builder();
    let min = builder.parameter("min", 1.0).range(0.0..=10.0).add();
    let max = builder.parameter("max", 9.0).range(0.0..=10.0).add();
    let parameters = builder.declare().unwrap();
    (min, max, parameters)
}

fn declare_with_changes(node: &Node) -> (Parameter<f64>, Parameter<f64>, Changes) {
    let mut builder = node.parameters_builder();
    let min = builder.parameter("min", 1.0).add();
    let max = builder.parameter("max", 9.0).add();
    let (_, changes) = builder.declare_with_changes().unwrap();
    (min, max, changes)
}

//= SM2-PRM-001 test
//= SM2-PRM-002 test
#[test]
fn a_set_is_made_although_the_program_does_nothing() {
    let domain = Domain::new();
    let (min, max, parameters) = declare(&driven(&domain, "lidar"));
    assert_eq!((min.get(), max.get()), (1.0, 9.0));
    let operator = Operator::new(&driven(&domain, "operator"));
    let table = next(&operator.tables);
    assert_eq!((table.revision, table.parameters.len()), (1, 2));

    let values = [("max", Value::Double(7.5)), ("min", Value::Double(2.0))];
    let result = operator.set(&values);
    assert_eq!(
        result,
        SetParametersResult {
            successful: true,
            reason: String::new(),
            revision: 2,
        }
    );
    // The reply comes after the values.
    assert_eq!((min.get(), max.get()), (2.0, 7.5));
    let table = next(&operator.tables);
    assert_eq!(table.revision, 2);
    assert_eq!(table.get("max").unwrap().value, Value::Double(7.5));
    assert_eq!(table.get("max").unwrap().origin, Origin::Set);
    assert_eq!(*parameters.snapshot().get(&max), 7.5);

    // The same values are not a change.
    assert_eq!(operator.set(&values).revision, 2);
    parameters.set(&max, 8.0).unwrap();
    assert_eq!(next(&operator.tables).revision, 3);
}

//= SM2-PRM-002 test
#[test]
fn all_values_of_a_request_are_set_or_none() {
    let domain = Domain::new();
    let (min, max, parameters) = declare(&driven(&domain, "lidar"));
    let operator = Operator::new(&driven(&domain, "operator"));
    let wrong = [
        ("max", Value::Integer(3)),
        ("max", Value::Double(10.5)),
        ("nothing", Value::Double(1.0)),
        ("min", Value::Double(3.0)),
    ];
    for (name, value) in wrong {
        let result = operator.set(&[("min", Value::Double(3.0)), (name, value)]);
        assert!(!result.successful);
        assert!(result.reason.contains(name), "{}", result.reason);
        assert_eq!((min.get(), max.get(), result.revision), (1.0, 9.0, 1));
    }
    let refused = parameters.set(&max, 11.0).unwrap_err();
    assert!(matches!(refused, SetError::Refused(_)), "{refused}");
    assert_eq!(max.get(), 9.0);
}

#[test]
fn a_program_accepts_and_refuses_changes_in_a_wait_set() {
    Fixture::each(|it| {
        let (min, max, changes) = declare_with_changes(&it.node("lidar"));
        let peer = it.peer("operator");
        let client: SetClient = peer.client("parameters/lidar").unwrap();
        let mut set = WaitSet::new().unwrap();
        set.add(&changes, ()).unwrap();
        until(|| {
            assert!(changes.try_next().unwrap().is_none());
            !client.links().is_empty() && client.links()[0].open
        });

        let mut ask = |value: f64, accept: bool| {
            let request = request(&[("min", Value::Double(value))]);
            let call = client.send_timeout(&request, SOON).unwrap();
            let change = loop {
                next_ready(&mut set);
                if let Some(change) = changes.try_next().unwrap() {
                    break change;
                }
            };
            assert_eq!(change.client().as_str(), "operator");
            assert_eq!(change.proposed(&min), Some(&value));
            assert_eq!(change.proposed(&max), None);
            assert_eq!((change.get(&min), change.get(&max)), (value, 9.0));
            // Nothing changes before the program has decided.
            assert_ne!(min.get(), value);
            match accept {
                true => assert!(change.accept()),
                false => change.refuse("no"),
            }
            (*call.wait().unwrap()).clone()
        };
        assert!(ask(2.0, true).successful);
        assert_eq!(min.get(), 2.0);
        assert_eq!(ask(3.0, false).reason, "no");
        assert_eq!(min.get(), 2.0);
    });
}

/// A request that breaks the rules never comes to the program, and a change that is dropped is refused.
#[test]
fn a_program_sees_only_legal_changes() {
    let domain = Domain::new();
    let (min, _, changes) = declare_with_changes(&driven(&domain, "lidar"));
    let operator = Operator::new(&driven(&domain, "operator"));
    let send = |value| {
        let request = request(&[("min", value)]);
        operator.client.send_timeout(&request, SOON).unwrap()
    };
    let wrong = send(Value::Bool(true));
    let right = send(Value::Double(4.0));
    let change = changes.next_timeout(SOON).unwrap().expect("a change");
    assert_eq!(change.get(&min), 4.0);
    let reply = wrong.wait().unwrap();
    assert!(reply.reason.contains("double"), "{}", reply.reason);
    drop(change);
    let reply = right.wait().unwrap();
    assert!(!reply.successful);
    assert!(reply.reason.contains("dropped"), "{}", reply.reason);
    assert_eq!(min.get(), 1.0);
}

#[test]
fn an_executor_has_changes() {
    let domain = Domain::new();
    let (min, _, changes) = declare_with_changes(&driven(&domain, "lidar"));
    let operator = Operator::new(&driven(&domain, "operator"));
    let shutdown = sm2_node::Shutdown::new().unwrap();
    let mut executor = Executor::new().unwrap();
    executor.end_with(&shutdown).unwrap();
    executor.group(()).on_change(changes, |(), change| {
        assert!(change?.accept());
        shutdown.request();
        Ok(())
    });
    std::thread::scope(|scope| {
        scope.spawn(|| assert!(operator.set(&[("min", Value::Double(5.0))]).successful));
        executor.run().unwrap();
    });
    assert_eq!(min.get(), 5.0);
}

/// A client that breaks the rules gets an error, and others are served as before.
//= SM2-PRM-004 test
#[test]
fn a_hostile_client_changes_nothing() {
    let domain = Domain::new();
    let (min, _, _parameters) = declare(&driven(&domain, "lidar"));
    let operator = Operator::new(&driven(&domain, "operator"));
    let hostile = driven(&domain, "hostile");
    let raw = hostile.client_builder::<[u8], [u8]>("parameters/lidar");
    let types = (SetParameters::type_id(), SetParametersResult::type_id());
    let raw = raw.type_ids(types.0, types.1).declare().unwrap();
    raw.wait_for_servers_timeout(1, SOON).unwrap();
    let call = |bytes: &[u8]| raw.call_timeout(bytes, SOON).unwrap_err();
    assert!(matches!(call(&[0xff; 64]), CallError::Failed { .. }));
    let longest = vec![0xff; TABLE_MAX];
    assert!(matches!(call(&longest), CallError::Failed { .. }));
    let too_long = vec![0xff; TABLE_MAX + 1];
    assert!(matches!(call(&too_long), CallError::TooLong { .. }));
    assert!(operator.set(&[("min", Value::Double(2.0))]).successful);
    assert_eq!(min.get(), 2.0);
}

/// A client that was told that nothing was set is right, also if the program decides later.
#[test]
fn a_change_whose_client_has_given_up_is_not_made() {
    let domain = Domain::new();
    let (min, _, changes) = declare_with_changes(&driven(&domain, "lidar"));
    let operator = Operator::new(&driven(&domain, "operator"));
    let request = request(&[("min", Value::Double(4.0))]);
    let call = operator.client.send_timeout(&request, SOON).unwrap();
    let change = changes.next_timeout(SOON).unwrap().expect("a change");
    // The cancellation comes before the next request.
    drop(call);
    let second = operator.client.send_timeout(&request, SOON).unwrap();
    let next = changes.next_timeout(SOON).unwrap().expect("a change");
    assert!(!change.accept());
    assert_eq!(min.get(), 1.0);
    assert!(next.accept());
    assert!(second.wait().unwrap().successful);
    assert_eq!(min.get(), 4.0);
}

/// The program does not see a request whose time limit has passed, although its client has not been able to cancel it.
#[test]
fn a_change_comes_in_time_or_never() {
    let domain = Domain::new();
    let by_hand = |name: &str| domain.builder(name).background(false).connect().unwrap();
    let [lidar, operator, other] = ["lidar", "operator", "other"].map(by_hand);
    let (min, _, changes) = declare_with_changes(&lidar);
    let client = |it: &Node| -> SetClient { it.client("parameters/lidar").unwrap() };
    let clients = [&operator, &other].map(client);
    until(|| {
        for node in [&lidar, &operator, &other] {
            node.spin_some().unwrap();
        }
        let is_linked = |it: &SetClient| it.links().iter().any(|it| it.open);
        clients.iter().all(is_linked)
    });
    let send = |client: &SetClient, value, timeout| {
        let request = request(&[("min", Value::Double(value))]);
        client.send_timeout(&request, timeout).unwrap()
    };
    let late = send(&clients[0], 4.0, Duration::from_millis(1));
    std::thread::sleep(Duration::from_millis(2));
    let right = send(&clients[1], 5.0, SOON);
    let change = changes.next_timeout(SOON).unwrap().expect("a change");
    assert_eq!(change.proposed(&min), Some(&5.0));
    assert!(changes.try_next().unwrap().is_none());
    drop((late, right));
}

/// A node whose program does not look at its parameters is read all the same.
#[test]
fn reading_needs_no_help_of_the_program() {
    let domain = Domain::new();
    let (_, _, _changes) = declare_with_changes(&driven(&domain, "lidar"));
    let reader = driven(&domain, "reader");
    let tables: Subscriber<Table> = reader.subscriber("parameters/lidar").unwrap();
    assert_eq!(next(&tables).parameters[1].name, "max");
}

//= SM2-PRM-006 test
#[test]
fn values_come_from_files() {
    let domain = Domain::new();
    let node = driven(&domain, "lidar");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.toml");
    let declare = |text: &str| {
        fs::write(&path, text).unwrap();
        let mut builder = node.parameters_builder().files([&path]);
        let max = builder.parameter("max", 9.0).range(0.0..=10.0).add();
        let frame = builder
            .parameter("frame", String::new())
            .read_only(true)
            .add();
        let parameters = builder.declare()?;
        Ok::<_, ParametersError>((max.get(), frame.get(), parameters))
    };
    let (max, frame, parameters) =
        declare("['*']\nmax = 3\nother = 1\n[lidar]\nframe = 'laser'\n").unwrap();
    assert_eq!((max, frame.as_str()), (3.0, "laser"));
    assert_eq!(
        parameters.snapshot().table().parameters[0].origin,
        Origin::File
    );
    drop(parameters);

    let error = declare("[lidar]\n\nmax = 'far'\n").unwrap_err().to_string();
    let place = format!("{}:3: ", path.display());
    assert!(error.starts_with(&place), "{error}");
    assert!(error.contains("max") && error.contains("double"), "{error}");
    let error = declare("[lidar]\nmax = 11\n").unwrap_err().to_string();
    assert!(error.contains(":2: max is 0.0 to 10.0"), "{error}");
    let error = declare("[lidar]\nmaxx = 1\n").unwrap_err().to_string();
    assert!(
        error.contains(":2: node lidar has no parameter maxx"),
        "{error}"
    );
}

/// Dropping the parameters withdraws them, so that the node can declare others.
#[test]
fn parameters_end_with_their_handle() {
    let domain = Domain::new();
    let node = driven(&domain, "lidar");
    let (min, _, parameters) = declare(&node);
    let clone = parameters.clone();
    drop(parameters);
    let again = node.parameters_builder().declare();
    assert!(matches!(again, Err(ParametersError::Again)));
    let operator = Operator::new(&driven(&domain, "operator"));
    assert!(operator.set(&[("min", Value::Double(2.0))]).successful);
    drop(clone);
    until(|| operator.client.links().iter().all(|it| it.end.is_some()));
    assert_eq!(min.get(), 2.0);
    let (again, _, _parameters) = declare(&node);
    assert_eq!(again.get(), 1.0);
}
