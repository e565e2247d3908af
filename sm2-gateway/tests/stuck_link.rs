//! A link that takes no datagrams fills the send buffer of its own socket, and of no other.

use std::{
    io::{ErrorKind, Write},
    net::{SocketAddr, UdpSocket},
    process::{Command, Stdio},
};

use quinn_proto::Transmit;
use sm2_io::quic::{Batch, Socket};
use sm2_lossy_link::Namespace;
use sm2_test_support::{SOON, skip, skip_without};
use tokio::time::timeout;

/// More than the buffers of a socket hold.
const DATAGRAMS: usize = 20_000;
const LEN_BYTES: usize = 1_200;

/// Runs the commands in the namespace of the calling thread. If they fail, reports the test as skipped and returns
/// false.
fn run(program: &str, commands: &str) -> bool {
    let child = Command::new(program)
        .args(["-batch", "-"])
        .stdin(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let mut child = match child {
        Ok(child) => child,
        Err(error) => {
            skip_without(program, error);
            return false;
        }
    };
    let written = child
        .stdin
        .take()
        .map(|mut it| it.write_all(commands.as_bytes()));
    let is_done = written.is_some_and(|it| it.is_ok()) && child.wait().is_ok_and(|it| it.success());
    if !is_done {
        skip(format_args!(
            "`{program}` fails, for example because the kernel has no tbf"
        ));
    }
    is_done
}

fn to(destination: SocketAddr) -> Transmit {
    Transmit {
        destination,
        ecn: None,
        size: LEN_BYTES,
        segment_size: None,
        src_ip: None,
    }
}

fn runtime() -> tokio::runtime::Runtime {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    runtime.expect("a runtime")
}

#[test]
fn a_link_that_takes_nothing_holds_up_one_socket() {
    let namespace = match Namespace::new() {
        Ok(namespace) => namespace,
        Err(error) => return skip(format_args!("no network namespace: {error}")),
    };
    let work = || {
        // The queue of `stuck` sends one byte a second, and holds more than the buffer of a socket.
        let is_set_up = run(
            "ip",
            "link set lo up\nlink add stuck type veth peer name far\naddr add 10.78.1.1/24 dev stuck\n\
             link set stuck up\nlink set far up\nneigh add 10.78.1.2 dev stuck lladdr 02:00:00:00:00:01\n",
        ) && run(
            "tc",
            "qdisc add dev stuck root tbf rate 8bit burst 10kb limit 100mb\n",
        );
        if !is_set_up {
            return;
        }
        runtime().block_on(async {
            let main = Socket::bind(SocketAddr::from(([0, 0, 0, 0], 0))).unwrap();
            let (one, other) = (main.sender().unwrap(), main.sender().unwrap());
            let stuck = to(SocketAddr::from(([10, 78, 1, 2], 7_633)));
            let bytes = [7; LEN_BYTES];
            let sent = timeout(SOON, one.send(&stuck, &bytes)).await;
            assert!(sent.expect("room").unwrap().is_none());
            let mut filled = (0..DATAGRAMS).map(|_| one.try_send(&stuck, &bytes));
            let full = filled.find_map(Result::err).expect("the buffer is full");
            assert_eq!(full.kind(), ErrorKind::WouldBlock);

            let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
            receiver.set_read_timeout(Some(SOON)).unwrap();
            let good = to(receiver.local_addr().unwrap());
            for socket in [&main, &other] {
                let sent = timeout(SOON, socket.send(&good, &bytes)).await;
                assert!(sent.expect("not held up").unwrap().is_none());
                let (len, from) = receiver.recv_from(&mut [0; LEN_BYTES]).unwrap();
                assert_eq!(len, LEN_BYTES);
                assert_eq!(from.port(), main.local_addr().unwrap().port());
            }
        });
    };
    namespace.enter(work).unwrap();
}

/// Datagrams arrive at the socket that was bound, however many share its address.
#[test]
fn senders_receive_nothing() {
    runtime().block_on(async {
        let main = Socket::bind(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
        let address = main.local_addr().unwrap();
        let _senders = [(); 8].map(|()| main.sender().unwrap());
        let mut batch = Batch::new();
        for number in 0..32 {
            // Without the filter, the kernel chooses a socket by the address of the sender.
            let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
            peer.send_to(&[number], address).unwrap();
            let received = timeout(SOON, main.recv(&mut batch)).await;
            received.expect("the datagram arrives").unwrap();
            let received: Vec<_> = batch.datagrams().map(|(_, _, it)| it.to_vec()).collect();
            assert_eq!(received, [[number]]);
        }
        let second = Socket::bind(address).map(drop).map_err(|it| it.kind());
        assert_eq!(second, Err(ErrorKind::AddrInUse));
    });
}
