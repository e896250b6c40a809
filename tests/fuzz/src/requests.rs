//! HTTP and WebSocket requests from arbitrary clients, as received by the page and by the bridge to Foxglove.
//!
//! Input: the bytes of one connection in pieces: a length (u16) and that many bytes, repeatedly.
//!
//! Properties: the connection ends as soon as the client closes it, with no answer or with an HTTP answer. The guard
//! admits no request that names another machine or comes from a foreign page. An admitted host name contains only
//! characters that are allowed in a header.

use std::{
    sync::atomic::{AtomicBool, Ordering::SeqCst},
    time::Duration,
};

use axum::{
    Router,
    extract::ws::{Message, WebSocket, WebSocketUpgrade},
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
    routing::get,
};
use inerter_serve::{guarded, limited, local_host, loopback, send, serve_connection};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt, duplex},
    time::timeout,
};

use crate::input::{Input, counted, seed};

/// Maximum length of a WebSocket message \[bytes\].
const MOST: usize = 64;
/// A connection that stays open for this long after the client closed it hangs. Shorter than any of the server's own
/// timeouts.
const HANGS: Duration = Duration::from_secs(2);

/// Whether more than [`MOST`] bytes of a message were ever kept. The task of a connection sets it because a panic there
/// would go unnoticed.
static HAS_KEPT_MUCH: AtomicBool = AtomicBool::new(false);

/// Checks an input.
pub fn check(mut input: Input) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
    let router = guarded(Router::new().route("/", get(page)).route("/live", get(live)));
    let answer = runtime.block_on(async {
        let (mut ours, theirs) = duplex(4096);
        let server = tokio::spawn(serve_connection(theirs, router));
        let (mut reader, mut writer) = tokio::io::split(&mut ours);
        let ask = async {
            while !input.is_empty() {
                // Fails once the server has closed the connection.
                if writer.write_all(input.counted()).await.is_err() {
                    break;
                }
            }
            writer.shutdown().await.ok();
        };
        let mut answer = Vec::new();
        let hear = async { reader.read_to_end(&mut answer).await.ok() };
        timeout(HANGS, async { tokio::join!(ask, hear) })
            .await
            .expect("a connection ends when its other end is closed");
        timeout(HANGS, server).await.expect("it ends").expect("it does not panic");
        answer
    });
    assert!(!HAS_KEPT_MUCH.load(SeqCst), "more than {MOST} bytes of a message were kept");
    assert!(answer.is_empty() || answer.starts_with(b"HTTP/1."), "{:?}", String::from_utf8_lossy(&answer));
}

async fn page(headers: HeaderMap) -> Response {
    assert_is_of_here(&headers);
    StatusCode::OK.into_response()
}

async fn live(headers: HeaderMap, upgrade: WebSocketUpgrade) -> Response {
    assert_is_of_here(&headers);
    limited(upgrade, MOST).on_upgrade(talk)
}

/// Echoes messages.
async fn talk(mut socket: WebSocket) {
    while let Some(Ok(message)) = socket.recv().await {
        let length = match &message {
            Message::Text(text) => text.len(),
            Message::Binary(bytes) | Message::Ping(bytes) | Message::Pong(bytes) => bytes.len(),
            Message::Close(_) => 0,
        };
        HAS_KEPT_MUCH.fetch_or(length > MOST, SeqCst);
        if send(&mut socket, message).await.is_none() {
            return;
        }
    }
}

fn assert_is_of_here(headers: &HeaderMap) {
    let host = local_host(headers).expect("the guard has seen to that");
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b".:[]".contains(&byte);
    assert!(host.bytes().all(is_plain), "{host:?} is to stand in a header");
    assert_eq!(loopback(&host).as_deref(), Some(host.as_str()), "what is let in is let in again");
    for origin in headers.get_all(header::ORIGIN) {
        let place = origin.as_bytes().strip_prefix(b"http://");
        let asked = headers.get(header::HOST).map(|host| host.as_bytes());
        assert!(place.is_some() && place == asked, "a page of {origin:?} was let in");
    }
}

/// Requests of browsers and programs, valid and malicious.
pub fn seeds() -> Vec<Vec<u8>> {
    let upgrade = "GET /live HTTP/1.1\r\nHost: localhost:9\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                   Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let plain = [
        "GET / HTTP/1.1\r\nHost: 127.0.0.1:9\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: [::1]:9\r\nOrigin: http://[::1]:9\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: [0::1]:+5\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: [::1%1]:9\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: LOCALHOST:09; x\r\nHost: localhost\r\nOrigin: null\r\n\r\n",
        "GET / HTTP/1.0\r\n\r\nGET /live HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n12345",
        "POST / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n12345\r\n0\r\n\r\n",
    ];
    let origins = ["", "Origin: http://localhost:9\r\n", "Origin: http://evil.example\r\n"];
    let upgrades = origins.map(|origin| counted(format!("{upgrade}{origin}\r\n")));
    // A text, a ping, a fragment without an end, a frame that is too long, a close; masked with zeros.
    let frames: [&[u8]; 5] = [
        b"\x81\x82\0\0\0\0hi",
        b"\x89\x80\0\0\0\0",
        b"\x01\x81\0\0\0\0a",
        b"\x82\xff\0\0\0\0\x7f\xff\xff\xff\0\0\0\0",
        b"\x88\x82\0\0\0\0\x03\xe8",
    ];
    let mut seeds: Vec<Vec<u8>> = plain.map(counted).into();
    seeds.extend(upgrades.clone());
    for frame in frames {
        seeds.push(seed(&upgrades[0], counted(frame)));
    }
    // Many requests whose answers nobody reads, then a malformed one.
    seeds.push(counted("GET / HTTP/1.1\r\n\r\n".repeat(40) + "nonsense\r\n\r\n"));
    let (begin, end) = plain[0].split_at(20);
    seeds.push([counted(begin), counted(end)].concat());
    seeds
}
