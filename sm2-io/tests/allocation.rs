//! Functions that are called for every message do not allocate.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::io::IoSlice;
use std::os::fd::AsFd;
use std::time::Duration;

use sm2_io::{CounterPage, Epoll, Events, Interest, RecvError, SeqPacket, Waker, wait_readable};
use sm2_proto::{Instant, InterfaceId, link};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed on to the system allocator; counting changes nothing about it.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise about `at` and `layout` is passed on.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

fn allocations(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

#[test]
fn the_path_of_a_message_does_not_allocate() {
    let (a, b) = SeqPacket::pair().unwrap();
    let waker = Waker::new().unwrap();
    let epoll = Epoll::new().unwrap();
    epoll.add(&b, 0, Interest::READABLE).unwrap();
    let mut events = Events::with_capacity(4);
    let parts = [IoSlice::new(b"head"), IoSlice::new(b"body")];
    let mut buffer = [0; 64];

    let count = allocations(|| {
        for _ in 0..10 {
            a.send(&parts, &[]).unwrap();
            epoll.wait(&mut events, None).unwrap();
            assert!(events.iter().all(|event| event.readable));
            assert!(wait_readable(&[b.as_fd(); 8], Some(Duration::ZERO)).unwrap());
            let received = b.recv(&mut buffer).unwrap();
            assert!(received.len == 8 && received.fds.is_empty());
            assert!(matches!(b.recv(&mut buffer), Err(RecvError::WouldBlock)));
            waker.wake();
            assert!(waker.drain());
            a.send(&parts, &[waker.as_fd()]).unwrap();
            drop(b.recv(&mut [0; 8]));
        }
    });
    // One allocation per datagram with descriptors: their list.
    assert_eq!(count, 10);
    assert_eq!(allocations(|| drop(Box::new(1_u8))), 1, "counts at all");
}

#[test]
fn counting_a_message_does_not_allocate() {
    let mut page = CounterPage::new().unwrap();
    let mut entry = page.allocate(InterfaceId(1), None, Instant(0)).unwrap();
    let count = allocations(|| {
        for message in 1..=100 {
            let mut update = entry.update();
            update.published(Instant(message), 10);
            update.taken(Instant(message), Instant(0), 10);
            update.lost(1);
            update.fates(&link::Counters::default());
        }
    });
    assert_eq!(count, 0);
}
