//! Errors of the UDP socket: those that a peer causes, and those that pass, do not reach the gateway.

use std::{
    io,
    net::{Ipv4Addr, UdpSocket},
    sync::mpsc,
    thread,
    time::Duration,
};

use nix::libc;
use quinn_proto::Transmit;
use sm2_io::{
    fault::{Call, Fault, Injector},
    quic::{Batch, Socket},
};
use sm2_test_support::SOON;
use tokio::{runtime::Builder, time::timeout};

fn failing(call: Call, errno: i32) -> Injector {
    Injector::new(Fault {
        call,
        nth: 1,
        times: 1,
        errno,
    })
}

/// Runs `work` with a socket, and a peer that sends to it without an end.
fn with_a_peer<W: Future<Output = ()>>(work: impl FnOnce(Socket, UdpSocket) -> W) {
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let socket = Socket::bind((Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let address = socket.local_addr().unwrap();
        let peer = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let sender = peer.try_clone().unwrap();
        let (end, ended) = mpsc::channel::<()>();
        let thread = thread::spawn(move || {
            while ended.recv_timeout(Duration::from_millis(2))
                == Err(mpsc::RecvTimeoutError::Timeout)
            {
                sender.send_to(b"x", address).unwrap();
            }
        });
        work(socket, peer).await;
        drop(end);
        thread.join().unwrap();
    });
}

#[test]
fn receiving_goes_on_after_an_error_that_belongs_to_no_datagram() {
    with_a_peer(|socket, peer| async move {
        let from = peer.local_addr().unwrap();
        for (errno, is_told) in [
            (libc::EAGAIN, false),
            (libc::ECONNREFUSED, false),
            (libc::EIO, true),
            (libc::ENOMEM, true),
        ] {
            let faults = failing(Call::UdpRecv, errno);
            let installed = faults.install();
            let mut batch = Batch::new();
            let received = timeout(SOON, socket.recv(&mut batch)).await;
            drop(installed);
            assert_eq!(faults.hits(), 1, "{errno}");
            let error = received.expect("a datagram").err();
            let errors: Vec<_> = error.iter().filter_map(io::Error::raw_os_error).collect();
            match is_told {
                true => assert_eq!(errors, [errno]),
                false => {
                    assert!(error.is_none(), "{error:?}");
                    let mut datagrams = batch.datagrams();
                    let first = datagrams.next().expect("a datagram");
                    assert_eq!(first, (from, first.1, &b"x"[..]));
                }
            }
        }
    });
}

#[test]
fn a_datagram_that_the_kernel_refuses_is_lost_and_the_reason_told() {
    with_a_peer(|socket, peer| async move {
        let transmit = Transmit {
            destination: peer.local_addr().unwrap(),
            ecn: None,
            size: 2,
            segment_size: None,
            src_ip: None,
        };
        let faults = failing(Call::UdpSend, libc::EPERM);
        let installed = faults.install();
        let sent = timeout(SOON, socket.send(&transmit, b"no")).await;
        let refused = sent.expect("an answer").unwrap();
        assert_eq!(refused.and_then(|it| it.raw_os_error()), Some(libc::EPERM));
        drop(installed);
        let sent = timeout(SOON, socket.send(&transmit, b"yes")).await;
        assert!(sent.expect("an answer").unwrap().is_none());
        peer.set_read_timeout(Some(SOON)).unwrap();
        let mut buffer = [0; 8];
        let len = peer.recv(&mut buffer).unwrap();
        assert_eq!(&buffer[..len], b"ye", "only as much as the connection says");
    });
}
