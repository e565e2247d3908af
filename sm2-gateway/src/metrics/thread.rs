//! A server of metrics in a thread of its own.

use std::{
    io,
    net::SocketAddr,
    thread::{self, JoinHandle},
};

use tokio::{net::TcpListener, runtime::Builder, sync::oneshot};

use super::server::{Made, Timeouts, serve};

/// Serves the metrics of a program that has no runtime of its own, at `http://ADDRESS/metrics`. Dropping it ends it.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens at an address. `text` makes the text, at most ten times per second: see [`encode`](super::encode).
    /// With `None`, the client gets the status 503.
    ///
    /// # Errors
    /// The address is in use, does not belong to this machine, or the system cannot start a thread.
    pub fn start<F>(address: SocketAddr, text: F) -> io::Result<Self>
    where
        F: Fn() -> Option<String> + Send + Sync + 'static,
    {
        let runtime = Builder::new_current_thread().enable_all().build()?;
        let listener = runtime.block_on(TcpListener::bind(address))?;
        let address = listener.local_addr()?;
        let (end, ended) = oneshot::channel();
        let make = Box::new(move || Box::pin(std::future::ready(text())) as Made);
        let run = move || {
            runtime.block_on(async {
                tokio::select! {
                    () = serve(listener, make, Timeouts::default()) => {}
                    _ = ended => {}
                }
            });
        };
        let thread = thread::Builder::new().name("metrics".to_owned());
        Ok(Self {
            address,
            end: Some(end),
            thread: Some(thread.spawn(run)?),
        })
    }

    /// The address, with its port if the system has chosen one.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::{Read, Write},
        net::TcpStream,
    };

    use sm2_test_support::SOON;

    use super::*;

    #[test]
    fn a_program_serves_its_text_until_the_server_is_dropped() {
        let server = Server::start("127.0.0.1:0".parse().unwrap(), || {
            Some("robots 7\n".to_owned())
        });
        let server = server.unwrap();
        let address = server.address();
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(SOON)).unwrap();
        stream
            .write_all(b"GET /metrics HTTP/1.1\r\nHost: here\r\n\r\n")
            .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        assert!(answer.ends_with("robots 7\n"), "{answer}");
        drop(server);
        TcpStream::connect(address).unwrap_err();
    }
}
