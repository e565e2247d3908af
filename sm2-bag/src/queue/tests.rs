use super::*;

const NOW: Duration = Duration::ZERO;

fn clock() -> Item {
    let wall_clock = sm2_node::clock::wall_time;
    Item::Clock(ClockRelation::read(wall_clock, sm2_io::clock::now))
}

#[test]
fn items_after_a_failure_are_dropped() {
    let queue = Queue::new(1_000).unwrap();
    queue.push(clock());
    queue.fail(WriteError::Panicked);
    queue.push(clock());
    let mut batch = Batch::default();
    assert!(queue.pop(&mut batch, Awaited::Item, NOW));
    assert!(batch.items.is_empty());
    assert!(matches!(queue.take_error(), Some(WriteError::Panicked)));
    assert!(queue.take_error().is_none());
    assert!(queue.has_failed());
}

#[test]
fn the_writer_is_woken_once_for_a_full_batch() {
    let queue = Queue::new(1_000).unwrap();
    let wakes = || queue.lock().awaited.is_none();
    queue.lock().awaited = Some(Awaited::Urgent);
    for _ in 0..BATCH_ITEMS - 1 {
        queue.push(clock());
    }
    assert!(!wakes());
    queue.push(clock());
    assert!(wakes());
    queue.push(clock());
    let mut batch = Batch::default();
    for len in [BATCH_ITEMS, 1, 0] {
        assert!(queue.pop(&mut batch, Awaited::Urgent, NOW));
        assert_eq!(batch.items.len(), len);
    }
    queue.lock().awaited = Some(Awaited::Item);
    queue.push(clock());
    assert!(wakes());
}

/// Waking the writer for each message would cost more than writing it.
#[test]
fn the_writer_is_woken_once_for_a_quarter_of_the_budget() {
    for budget in [1_000, 1_003] {
        let queue = Queue::new(budget).unwrap();
        let name = |text| sm2_proto::Name::new(text).unwrap();
        let source = Arc::new(Source {
            topic: name("scan"),
            publisher: name("lidar"),
            data: sm2_proto::TypeId {
                name: name("u8"),
                hash: 1,
            },
            offer: sm2_proto::OfferedQos::new(1),
            schema: None,
        });
        let times = MessageTimes {
            sequence: 1,
            log_time: 1,
            publish_time: 1,
        };
        let push = |len| queue.push_copy(Arc::clone(&source), times, &vec![0; len]);
        let wakes = || queue.lock().awaited.is_none();
        queue.lock().awaited = Some(Awaited::Urgent);
        push(100);
        push(149);
        assert!(!wakes(), "{budget}");
        push(1);
        assert!(wakes(), "{budget}");
    }
}

#[test]
fn the_end_of_a_file_is_urgent() {
    let queue = Queue::new(1_000).unwrap();
    queue.push(clock());
    queue.push(Item::EndFile(7));
    queue.close();
    let mut batch = Batch::default();
    assert!(!queue.pop(&mut batch, Awaited::Urgent, NOW));
    let [Item::Clock(_), Item::EndFile(7)] = &batch.items[..] else {
        panic!("{:?}", batch.items);
    };
}
