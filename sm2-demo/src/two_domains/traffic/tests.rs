use sm2_manager::Background;

use super::*;

/// An unknown message may be old: its bytes are intact, too.
#[test]
fn a_message_is_damaged_if_its_bytes_are_or_if_it_was_never_sent() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("sock");
    let _manager = Background::start(&socket, sm2_manager::Options::default()).unwrap();
    let node = |name| Node::builder(name).socket(&socket).connect().unwrap();
    let (talker, listener) = (node("talker"), node("listener"));
    let publisher = talker.publisher::<[u8]>(TOPIC).unwrap();
    let shared = Arc::new(Shared::default());
    let (log, thread) = subscribe(&listener, Arc::clone(&shared), 8).unwrap();
    let soon = Duration::from_secs(60);
    publisher.wait_for_subscribers_timeout(1, soon).unwrap();
    let mut message = [0; 100];
    for (number, is_sent, is_whole) in [(1, true, true), (2, false, true), (3, true, false)] {
        if is_sent {
            lock(&shared.sent).insert(number, clock::now());
        }
        pattern::fill(number, &mut message);
        message[50] ^= u8::from(!is_whole);
        publisher.publish(&message).unwrap();
    }
    let until = clock::now().after(soon);
    while lock(&log).len() < 3 {
        assert!(clock::now() < until, "{:?}", lock(&log));
        thread::sleep(Duration::from_millis(1));
    }
    shared.stop.store(true, Ordering::Relaxed);
    thread.join().unwrap().unwrap();
    let damaged: Vec<_> = lock(&log).iter().map(|it| it.damaged).collect();
    assert_eq!(damaged, [false, true, true]);
}
