//! Long work is observed, and ended.

use std::ops::ControlFlow;
use std::time::Duration;

use sm2_bag::{
    Bag, BagFiles, Compression, CopyError, Filter, Observer, Options, ReadError, copy_observed,
    diff_observed, recover_observed,
};

use crate::common::{Domain, named, record};

const MESSAGES: u64 = 20;
const MESSAGE_BYTES: u64 = 100_000;

/// A bag of long messages, each a chunk of its own.
fn record_bag(domain: &Domain) {
    let talker = domain.node("talker");
    let publisher = talker.publisher_builder::<[u8]>("data").reliable(true);
    let publisher = publisher.declare().unwrap();
    let options = Options {
        reliable: ["data"].map(|it| sm2_node::Name::new(it).unwrap()).into(),
        sync_interval: Duration::from_millis(1),
        ..Options::new(named(&["data"]))
    };
    let node = domain.node("recorder");
    record(&node, domain.create("bag"), options, |record_until| {
        record_until(&mut |_| publisher.links().iter().any(|it| it.open));
        for count in 1..=MESSAGES {
            publisher.publish(&[7; MESSAGE_BYTES as usize]).unwrap();
            record_until(&mut |it| it.progress().messages == count);
        }
    });
}

/// Runs the work to its end, and then with an observer that ends it after half of the bytes. Returns the number of
/// bytes.
fn observe<T, E: Into<CopyError> + std::fmt::Debug>(
    mut work: impl FnMut(&mut Observer<'_>) -> Result<T, E>,
) -> u64 {
    let mut all = 0;
    work(&mut |bytes| {
        all += bytes;
        ControlFlow::Continue(())
    })
    .unwrap();
    let mut read = 0;
    let stopped = work(&mut |bytes| {
        assert!(read <= all / 2, "the work goes on");
        read += bytes;
        match read > all / 2 {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    });
    let error = stopped.err().expect("the work was ended").into();
    assert!(
        matches!(error, CopyError::Read(ReadError::Stopped)),
        "{error}"
    );
    all
}

#[test]
fn work_with_bags_is_observed_and_ended() {
    let domain = Domain::new();
    record_bag(&domain);
    let (path, to) = (domain.path("bag"), domain.path("new"));
    let payloads = MESSAGES * MESSAGE_BYTES;
    let file_bytes = path.metadata().unwrap().len();
    let is_file = |bytes: u64| bytes > payloads && bytes <= file_bytes;

    assert!(is_file(observe(|it| BagFiles::find(&path)
        .unwrap()
        .check(it))));
    let bag = Bag::open(&path).unwrap();
    let differ = observe(|it| diff_observed([std::slice::from_ref(&bag); 2], it));
    assert_eq!(differ, 2 * payloads);
    // A complete bag is not read when it is opened.
    Bag::open_observed(&path, &mut |_| ControlFlow::Break(())).unwrap();

    let filter = Filter::default();
    let bags = [bag];
    // The copy that is ended is removed, so that the name is free again.
    let copied = observe(|it| {
        let _ = std::fs::remove_file(&to);
        copy_observed(&bags, &to, &filter, Compression::None, it)
    });
    assert_eq!(copied, payloads);
    assert!(!to.exists());
    let recovered = observe(|it| {
        let _ = std::fs::remove_file(&to);
        recover_observed(&path, &to, it)
    });
    assert!(is_file(recovered / 2), "{recovered}");
    assert!(!to.exists());

    // A bag without a summary is read when it is opened.
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&to, &bytes[..bytes.len() - 100]).unwrap();
    assert!(is_file(observe(|it| Bag::open_observed(&to, it))));
}
