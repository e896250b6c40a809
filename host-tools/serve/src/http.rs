//! HTTP for the page and for Foxglove, in a separate thread, with limits, because anybody may connect.
//!
//! A connection serves one request and ends [`REQUEST_TIME`] after it began, whatever it sent; a WebSocket stays as
//! long as its peer accepts each message within [`SEND_TIME`]. At [`MOST`] connections the oldest one that is not a
//! WebSocket makes room for a new one. With a low limit on open files there are fewer connections, so that the device
//! can always be opened again.

use std::{collections::VecDeque, io, net::SocketAddr, sync::Arc, thread::JoinHandle, time::Duration};

use axum::{
    Extension, Router,
    extract::{
        Request,
        ws::{Message, WebSocket, WebSocketUpgrade},
    },
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    middleware::{self, Next},
    response::{IntoResponse, Response},
};
use hyper::server::conn::http1;
use hyper_util::{rt::TokioIo, service::TowerToHyperService};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::TcpListener,
    sync::{OwnedSemaphorePermit, Semaphore, oneshot},
    task::JoinHandle as Task,
    time::{sleep, timeout},
};

use crate::host::loopback;

/// Time for a connection's requests and answers.
const REQUEST_TIME: Duration = Duration::from_secs(5);
/// Time to send a message to the peer of a WebSocket.
const SEND_TIME: Duration = Duration::from_secs(30);
/// Maximum number of connections.
const MOST: usize = 32;
/// File descriptors reserved for everything else: the device, the recording, the list of ports.
const RESERVE: usize = 32;
/// Number of servers: the page and the bridge to Foxglove.
const SERVERS: usize = 2;
/// Pause after a connection could not be accepted.
const RETRY: Duration = Duration::from_millis(100);

/// A connection's slot among all; whoever continues with the connection keeps it.
#[derive(Clone)]
pub struct Place {
    _permit: Arc<OwnedSemaphorePermit>,
}

/// A server that runs until it is dropped.
pub struct Server {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens at this address; `name` is the thread's.
    pub fn start(name: &str, address: SocketAddr, router: Router) -> io::Result<Self> {
        let listener = std::net::TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let listener = runtime.block_on(async { TcpListener::from_std(listener) })?;
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::Builder::new().name(name.into()).spawn(move || {
            runtime.block_on(async move {
                tokio::select! {
                    () = serve(&listener, &router) => {}
                    _ = stopped => {}
                }
            });
        })?;
        Ok(Self { address, stop: Some(stop), thread: Some(thread) })
    }

    /// The address it listens at, with the actual port number.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

async fn serve(listener: &TcpListener, router: &Router) {
    let places = Arc::new(Semaphore::new(most_connections(open_files())));
    let mut requests: VecDeque<Task<_>> = VecDeque::new();
    loop {
        // Fails if no more files can be opened.
        let Ok((stream, _)) = listener.accept().await else {
            sleep(RETRY).await;
            continue;
        };
        requests.retain(|request| !request.is_finished());
        while places.available_permits() == 0
            && let Some(oldest) = requests.pop_front()
        {
            oldest.abort();
            oldest.await.ok();
        }
        // No slot is free if all connections are WebSockets.
        let Ok(place) = places.clone().try_acquire_owned() else { continue };
        let router = router.clone().layer(Extension(Place { _permit: Arc::new(place) }));
        requests.push_back(tokio::spawn(serve_connection(stream, router)));
    }
}

/// Answers one request on a connection, within five seconds. If it answered more, a client that does not read could
/// make answers pile up; a malformed request behind them then fails a debug assertion of hyper.
pub async fn serve_connection(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, router: Router) {
    let router = router.layer(middleware::map_response(last));
    let connection =
        http1::Builder::new().serve_connection(TokioIo::new(stream), TowerToHyperService::new(router)).with_upgrades();
    // The reason why a connection ended is not needed.
    drop(timeout(REQUEST_TIME, connection).await);
}

/// The response as the last one of its connection, unless a WebSocket follows it.
async fn last(mut response: Response) -> Response {
    if response.status() != StatusCode::SWITCHING_PROTOCOLS {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}

/// Maximum number of open files.
#[cfg(unix)]
fn open_files() -> Option<u64> {
    rustix::process::getrlimit(rustix::process::Resource::Nofile).current
}

#[cfg(not(unix))]
fn open_files() -> Option<u64> {
    None
}

fn most_connections(open_files: Option<u64>) -> usize {
    let all = open_files.and_then(|files| usize::try_from(files).ok()).unwrap_or(usize::MAX);
    (all.saturating_sub(RESERVE) / SERVERS).clamp(1, MOST)
}

/// Sends a message; `None` if the peer is gone or does not accept it.
pub async fn send(socket: &mut WebSocket, message: Message) -> Option<()> {
    timeout(SEND_TIME, socket.send(message)).await.ok()?.ok()
}

/// Limits the size of messages from the peer to this many bytes.
pub fn limited(upgrade: WebSocketUpgrade, bytes: usize) -> WebSocketUpgrade {
    // Single frames have their own limit, which is checked first.
    upgrade.max_message_size(bytes).max_frame_size(bytes)
}

/// A header that occurs at most once; an error if it occurs twice or is not text.
fn single(headers: &HeaderMap, name: HeaderName) -> Result<Option<&str>, ()> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (Some(_), Some(_)) => Err(()),
        (value, _) => value.map(|value| value.to_str().map_err(|_| ())).transpose(),
    }
}

/// The only `Host` of a request, if it names this machine.
pub fn local_host(headers: &HeaderMap) -> Option<String> {
    loopback(single(headers, header::HOST).ok()??)
}

/// Accepts only requests that name this machine and do not come from a page elsewhere, and adds the security headers to
/// the answer.
pub fn guarded(router: Router) -> Router {
    router.layer(middleware::from_fn(guard))
}

async fn guard(request: Request, next: Next) -> Response {
    if !from_here(request.headers()) {
        return (StatusCode::FORBIDDEN, "only pages of this machine may connect\n").into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    for (name, value) in [
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

fn from_here(headers: &HeaderMap) -> bool {
    let Ok(Some(host)) = single(headers, header::HOST) else { return false };
    loopback(host).is_some() && comes_from(headers, |origin| origin == format!("http://{host}"))
}

/// Whether a request names no origin, or only an allowed one. Browsers send it wherever it matters; curl does not.
pub fn comes_from(headers: &HeaderMap, is_allowed: impl Fn(&str) -> bool) -> bool {
    single(headers, header::ORIGIN).is_ok_and(|origin| origin.is_none_or(is_allowed))
}

#[cfg(test)]
mod tests {
    use std::{
        io::{Read, Write},
        net::TcpStream,
        sync::atomic::{AtomicUsize, Ordering::SeqCst},
    };

    use super::*;

    /// Requests in progress, and their maximum so far.
    #[derive(Default)]
    struct Load {
        now: AtomicUsize,
        most: AtomicUsize,
        all: AtomicUsize,
    }

    struct Counted(Arc<Load>);

    impl Drop for Counted {
        fn drop(&mut self) {
            self.0.now.fetch_sub(1, SeqCst);
        }
    }

    #[test]
    fn no_more_than_so_many_connections_are_served_and_the_oldest_ends_first() {
        let load = Arc::new(Load::default());
        let counts = load.clone();
        let router = Router::new().fallback(move || {
            let counts = counts.clone();
            async move {
                counts.most.fetch_max(counts.now.fetch_add(1, SeqCst) + 1, SeqCst);
                counts.all.fetch_add(1, SeqCst);
                let _counted = Counted(counts);
                std::future::pending::<()>().await
            }
        });
        let server = Server::start("test", ([127, 0, 0, 1], 0).into(), router).unwrap();
        let most = most_connections(open_files());
        let mut streams = Vec::new();
        for count in 1..=most + 8 {
            let mut stream = TcpStream::connect(server.address()).unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
            while load.all.load(SeqCst) < count {
                std::thread::yield_now();
            }
            streams.push(stream);
        }
        assert_eq!((load.most.load(SeqCst), load.now.load(SeqCst)), (most, most));
        // The connections that made room have ended.
        for stream in streams.iter_mut().take(8) {
            assert!(matches!(stream.read(&mut [0; 1]), Ok(0) | Err(_)));
        }
    }

    #[test]
    fn a_connection_serves_one_request_and_no_nonsense_after_it() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        let answers = runtime.block_on(async {
            let (mut ours, theirs) = tokio::io::duplex(4096);
            let server = tokio::spawn(serve_connection(theirs, Router::new()));
            let asked = "GET / HTTP/1.1\r\n\r\n".repeat(40) + "nonsense\r\n\r\n";
            tokio::io::AsyncWriteExt::write_all(&mut ours, asked.as_bytes()).await.unwrap();
            let mut answers = String::new();
            tokio::io::AsyncReadExt::read_to_string(&mut ours, &mut answers).await.unwrap();
            server.await.unwrap();
            answers
        });
        assert_eq!(answers.matches("HTTP/1.1 404 Not Found").count(), 1, "{answers}");
        assert_eq!(answers.matches("HTTP/").count(), 1, "{answers}");
    }

    #[test]
    fn only_this_machine_is_let_in() {
        let headers = |list: &[(HeaderName, &str)]| {
            list.iter()
                .map(|(name, value)| (name.clone(), HeaderValue::from_str(value).unwrap()))
                .collect::<HeaderMap>()
        };
        let host = (header::HOST, "127.0.0.1:9");
        assert!(from_here(&headers(std::slice::from_ref(&host))));
        assert!(from_here(&headers(&[host.clone(), (header::ORIGIN, "http://127.0.0.1:9")])));
        for other in [host.clone(), (header::HOST, "evil.example")] {
            assert!(!from_here(&headers(&[host.clone(), other])), "two hosts");
        }
        for origin in ["http://evil.example", "null", "https://127.0.0.1:9", "http://127.0.0.1:10"] {
            assert!(!from_here(&headers(&[host.clone(), (header::ORIGIN, origin)])), "{origin}");
        }
        assert!(!from_here(&headers(&[])));
        assert!(!from_here(&headers(&[(header::HOST, "evil.example")])));
    }

    #[test]
    fn files_stay_free_for_the_device() {
        for (files, most) in [(Some(1024), 32), (Some(96), 32), (Some(64), 16), (Some(40), 4), (Some(8), 1), (None, 32)]
        {
            assert_eq!(most_connections(files), most, "{files:?}");
        }
    }
}
