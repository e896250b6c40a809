//! Tests of the server with a minimal client, without a kernel.

use super::protocol::HEADER;
use super::*;
use crate::usb_host::tests::Puppet;

/// A client that alternates with the server in one thread, so that neither blocks.
struct Peer {
    stream: TcpStream,
    bytes: Vec<u8>,
}

impl Peer {
    fn connect(server: &Server<Puppet>) -> Self {
        let stream = TcpStream::connect(server.address().expect("the server is bound")).expect("loopback connection");
        stream.set_nonblocking(true).expect("non-blocking socket");
        Self { stream, bytes: Vec::new() }
    }

    fn send(&mut self, words: &[u32], more: &[u8]) {
        let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
        bytes.extend_from_slice(more);
        self.stream.write_all(&bytes).expect("the bytes are sent");
    }

    fn import(&mut self, name: &str) {
        let mut id = name.as_bytes().to_vec();
        id.resize(32, 0);
        self.send(&[0x0111_8003, 0], &id);
    }

    fn submit(&mut self, sequence: u32, to_host: bool, endpoint: u32, length: u32, setup: [u8; 8], data: &[u8]) {
        let head = [1, sequence, 0x1_0002, to_host.into(), endpoint, 0, length, 0, 0, 0];
        self.send(&head, &[setup.as_slice(), data].concat());
    }

    /// Reads this many bytes, or fewer if the server closes the connection.
    fn take(&mut self, server: &mut Server<Puppet>, count: usize) -> Vec<u8> {
        let mut portion = [0; 1024];
        for _ in 0..100_000 {
            match self.stream.read(&mut portion) {
                Ok(0) => return std::mem::take(&mut self.bytes),
                Ok(count) => self.bytes.extend_from_slice(&portion[..count]),
                Err(_) => {}
            }
            if self.bytes.len() >= count {
                return self.bytes.drain(..count).collect();
            }
            server.turn().expect("the device runs");
        }
        panic!("received only {} of {count} bytes", self.bytes.len());
    }

    /// A reply: command, sequence number, status, number of bytes transferred, and its data.
    fn take_return(&mut self, server: &mut Server<Puppet>, to_host: bool) -> (u32, u32, i32, u32, Vec<u8>) {
        let head = self.take(server, HEADER);
        let word = |at: usize| u32::from_be_bytes(head[4 * at..4 * at + 4].try_into().expect("four bytes"));
        let moved = word(6);
        let data = if to_host { self.take(server, moved as usize) } else { vec![] };
        (word(0), word(1), word(5) as i32, moved, data)
    }
}

fn imported() -> (Server<Puppet>, Peer) {
    let mut server = Server::new(Puppet::new()).expect("a free port");
    let mut peer = Peer::connect(&server);
    peer.import("1-1");
    let reply = peer.take(&mut server, 320);
    assert_eq!(reply[..8], [1, 0x11, 0, 3, 0, 0, 0, 0]);
    assert_eq!(reply[8 + 256 + 32 + 8..][..4], [0, 0, 0, 2], "full speed");
    assert_eq!(reply[8 + 256 + 32 + 12..][..4], [0x12, 0x09, 0, 1], "vendor and product");
    // SET_CONFIGURATION, as the client's kernel does after its own enumeration.
    peer.submit(1, false, 0, 0, [0, 9, 1, 0, 0, 0, 0, 0], &[]);
    assert_eq!(peer.take_return(&mut server, false), (3, 1, 0, 0, vec![]));
    (server, peer)
}

#[test]
fn devices_are_listed() {
    let mut server = Server::new(Puppet::new()).expect("a free port");
    let mut peer = Peer::connect(&server);
    peer.send(&[0x0111_8005, 0], &[]);
    let reply = peer.take(&mut server, 12 + 312 + 4);
    assert_eq!(reply[..12], [1, 0x11, 0, 5, 0, 0, 0, 0, 0, 0, 0, 1]);
    assert_eq!(reply[12 + 312..], [10, 0, 0, 0], "one interface");
    assert!(!server.is_imported());
}

#[test]
fn bytes_go_through_and_back() {
    let (mut server, mut peer) = imported();
    peer.submit(2, true, 1, 128, [0; 8], &[]);
    peer.submit(3, false, 1, 5, [0; 8], b"hello");
    assert_eq!(peer.take_return(&mut server, false), (3, 3, 0, 5, vec![]));
    assert_eq!(peer.take_return(&mut server, true), (3, 2, 0, 5, b"hello".to_vec()));
}

#[test]
fn device_time_stands_still_for_a_moment_while_no_read_is_pending() {
    let (mut server, mut peer) = imported();
    peer.submit(2, true, 1, 128, [0; 8], &[]);
    server.turn().expect("the device runs");
    assert!(!server.stands_still(Instant::now()), "a read is pending");
    peer.submit(3, false, 1, 5, [0; 8], b"hello");
    peer.take_return(&mut server, false);
    peer.take_return(&mut server, true);
    let since = server.starved[&1];
    assert!(server.stands_still(since), "no read is pending");
    assert!(!server.stands_still(since + READ_TIME), "the client has stopped reading");
    // The interrupt endpoint is another: a read of it is no help.
    peer.submit(4, true, 2, 128, [0; 8], &[]);
    for _ in 0..100 {
        server.turn().expect("the device runs");
    }
    assert!(server.stands_still(since));
    peer.submit(5, true, 1, 128, [0; 8], &[]);
    let mut turns = 0..10_000;
    while server.stands_still(since) && turns.next().is_some() {
        server.turn().expect("the device runs");
    }
    assert!(!server.stands_still(since), "the next read is pending");
}

#[test]
fn a_request_that_the_device_refuses_is_a_broken_pipe() {
    let (mut server, mut peer) = imported();
    peer.submit(2, true, 0, 4, [0xC0, 0x33, 0, 0, 0, 0, 4, 0], &[]);
    assert_eq!(peer.take_return(&mut server, true), (3, 2, errno::BROKEN_PIPE, 0, vec![]));
}

#[test]
fn a_transfer_is_taken_back_once() {
    let (mut server, mut peer) = imported();
    peer.submit(2, true, 1, 128, [0; 8], &[]);
    let unlink = |peer: &mut Peer, sequence: u32| peer.send(&[2, sequence, 0x1_0002, 0, 0, 2, 0, 0, 0, 0, 0, 0], &[]);
    unlink(&mut peer, 3);
    assert_eq!(peer.take_return(&mut server, false), (4, 3, errno::RESET, 0, vec![]));
    unlink(&mut peer, 4);
    assert_eq!(peer.take_return(&mut server, false), (4, 4, 0, 0, vec![]));
    assert_eq!(server.counts.unlinked, 1);
}

#[test]
fn a_second_client_is_told_that_the_device_is_busy() {
    let (mut server, mut first) = imported();
    let mut second = Peer::connect(&server);
    second.import("1-1");
    assert_eq!(second.take(&mut server, 8), [1, 0x11, 0, 3, 0, 0, 0, 2]);
    assert_eq!(second.take(&mut server, 1), [], "closed");
    let mut third = Peer::connect(&server);
    third.import("9-9");
    assert_eq!(third.take(&mut server, 8), [1, 0x11, 0, 3, 0, 0, 0, 4]);
    first.submit(2, true, 0, 18, [0x80, 6, 0, 1, 0, 0, 18, 0], &[]);
    assert_eq!(first.take_return(&mut server, true).3, 18, "the first one goes on");
    assert_eq!(server.counts, Counts { imports: 1, busy: 1, transfers: 2, unlinked: 0, foreign: 0 });
}

#[test]
fn a_client_that_goes_away_pulls_the_cable_out() {
    let (mut server, peer) = imported();
    assert!(server.socket.supplied());
    drop(peer);
    server.turn().expect("the device runs");
    assert!(!server.socket.supplied());
    assert!(!server.is_imported());
    let mut next = Peer::connect(&server);
    next.import("1-1");
    assert_eq!(next.take(&mut server, 320).len(), 320);
}

#[test]
fn an_unplugged_device_ends_the_connection() {
    let (mut server, mut peer) = imported();
    peer.submit(2, true, 1, 128, [0; 8], &[]);
    server.turn().expect("the device runs");
    server.unplug();
    assert_eq!(peer.take(&mut server, 1), []);
}

#[test]
fn a_stranger_is_sent_away() {
    let mut server = Server::new(Puppet::new()).expect("a free port");
    let mut peer = Peer::connect(&server);
    peer.stream.write_all(b"GET / HTTP/1.1\r\n\r\n").expect("the bytes are sent");
    assert_eq!(peer.take(&mut server, 1), []);
    assert_eq!(server.counts.foreign, 1);
}
