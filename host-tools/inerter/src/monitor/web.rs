//! The page: one self-contained HTML page on loopback, with the screen's contents, live through a WebSocket.
//!
//! Only clients that know the random token in the address are let in. A request must name a loopback host, so that no
//! other site can reach the server through a host name that resolves to it, and must not come from another origin. The
//! page loads nothing from elsewhere, and its content security policy forbids it.

mod messages;

use std::sync::{Arc, Mutex, mpsc::Sender};

use axum::{
    Extension, Router,
    extract::{
        State,
        ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade},
    },
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{Html, IntoResponse, Response},
    routing::get,
};
use inerter_serve::{Place, Server, guarded, limited, local_host, send};
use serde::Deserialize;
use tokio::sync::broadcast;

use super::{
    MonitorError,
    address::{PAGE, resolve},
    feed::Item,
    hub::{Viewer, Wish},
    locked,
};
use crate::Error;
use messages::Messages;

/// Messages queued for a slow page before it receives the full state again: about 20 s.
const BACKLOG: usize = 256;
/// Size limit of a message from a page \[bytes\].
const MOST_FROM_PAGE: usize = 4096;
/// Maximum length of a marker's text.
const MARKER_LETTERS: usize = 200;

const HTML: &str = include_str!("../../assets/monitor.html");
const CSS: &str = include_str!("../../assets/monitor.css");
const SCRIPT: &str = include_str!("../../assets/monitor.js");
const PLOT: &str = include_str!("../../assets/uplot/uPlot.iife.min.js");
const PLOT_CSS: &str = include_str!("../../assets/uplot/uPlot.min.css");

/// What a page may request.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Asked {
    Marker(String),
    ResetEstimator(bool),
}

/// What the server's tasks share.
struct Shared {
    messages: Mutex<Messages>,
    sender: broadcast::Sender<Utf8Bytes>,
    wishes: Mutex<Sender<Wish>>,
}

/// The page's server, which runs until it is dropped.
pub struct Web {
    shared: Arc<Shared>,
    /// The page's address, token included.
    pub url: String,
    _server: Server,
}

impl Web {
    /// Serves at a loopback address.
    pub fn start(bind: &str, wishes: Sender<Wish>, recording: Option<String>) -> Result<Self, MonitorError> {
        let address = resolve("--bind", bind, PAGE)?;
        if !address.ip().is_loopback() {
            return Err(MonitorError::NotLoopback { address: bind.into(), resolved: address });
        }
        let token = token()?;
        let (sender, _) = broadcast::channel(BACKLOG);
        let shared =
            Arc::new(Shared { messages: Mutex::new(Messages::new(recording)), sender, wishes: Mutex::new(wishes) });
        let server = Server::start("page", address, router(&token, shared.clone())).map_err(|error| {
            let (what, option, reason) = ("the page", "--bind", error.to_string());
            MonitorError::Listen { what, option, address: bind.into(), example: PAGE, reason }
        })?;
        Ok(Self { shared, url: format!("http://{}/{token}/", server.address()), _server: server })
    }
}

impl Viewer for Web {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        let mut messages = locked(&self.shared.messages);
        if let Some(message) = messages.take(item) {
            // Having no viewer is not an error.
            self.shared.sender.send(message.to_string().into()).ok();
        }
        Ok(())
    }
}

/// 128 bits from the operating system, in hexadecimal.
fn token() -> Result<String, MonitorError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| MonitorError::Random { reason: error.to_string() })?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn router(token: &str, shared: Arc<Shared>) -> Router {
    let pages = Router::new()
        .route(&format!("/{token}/"), get(page))
        .route(&format!("/{token}/live"), get(live))
        .fallback(|| async {
            (StatusCode::FORBIDDEN, "the address is incomplete: open the one that `inerter monitor --web` printed\n")
        })
        .with_state(shared);
    guarded(pages)
}

async fn page(headers: HeaderMap) -> Response {
    let Ok(nonce) = token() else { return StatusCode::INTERNAL_SERVER_ERROR.into_response() };
    let Some(host) = local_host(&headers) else { return StatusCode::FORBIDDEN.into_response() };
    let html = HTML
        .replace("{nonce}", &nonce)
        .replace("{css}", &[PLOT_CSS, CSS].concat())
        .replace("{script}", &[PLOT, SCRIPT].concat());
    // `ws:` is listed explicitly: not every browser includes it in 'self'.
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src ws://{host}; \
         img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    let Ok(policy) = HeaderValue::from_str(&policy) else { return StatusCode::BAD_REQUEST.into_response() };
    ([(header::CONTENT_SECURITY_POLICY, policy)], Html(html)).into_response()
}

async fn live(
    State(shared): State<Arc<Shared>>,
    Extension(place): Extension<Place>,
    upgrade: WebSocketUpgrade,
) -> Response {
    limited(upgrade, MOST_FROM_PAGE).on_upgrade(move |socket| async move {
        talk(socket, shared, place).await;
    })
}

/// Sends a page the full state, then every update, and accepts its requests, until either end is gone.
async fn talk(mut socket: WebSocket, shared: Arc<Shared>, _place: Place) -> Option<()> {
    let mut receiver = begin(&mut socket, &shared).await?;
    loop {
        tokio::select! {
            message = receiver.recv() => match message {
                Ok(message) => send(&mut socket, Message::Text(message)).await?,
                // The page was too slow: it receives the full state again.
                Err(broadcast::error::RecvError::Lagged(_)) => receiver = begin(&mut socket, &shared).await?,
                Err(broadcast::error::RecvError::Closed) => return None,
            },
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) => asked(&text, &shared),
                Some(Ok(Message::Close(_)) | Err(_)) | None => return None,
                Some(Ok(_)) => {}
            },
        }
    }
}

/// The full state so far, and a receiver for the messages right after it.
async fn begin(socket: &mut WebSocket, shared: &Shared) -> Option<broadcast::Receiver<Utf8Bytes>> {
    let (all, receiver) = {
        // No message is sent to the receivers while this lock is held.
        let messages = locked(&shared.messages);
        (messages.all(), shared.sender.subscribe())
    };
    for message in all {
        send(socket, Message::Text(message.to_string().into())).await?;
    }
    Some(receiver)
}

fn asked(text: &str, shared: &Shared) {
    let wish = match serde_json::from_str(text) {
        Ok(Asked::Marker(text)) => {
            let letters: String =
                text.trim().chars().filter(|letter| !letter.is_control()).take(MARKER_LETTERS).collect();
            Wish::Mark(if letters.is_empty() { "marker".into() } else { letters })
        }
        Ok(Asked::ResetEstimator(true)) => Wish::ResetEstimator,
        // The message is not from our page.
        Ok(Asked::ResetEstimator(false)) | Err(_) => return,
    };
    locked(&shared.wishes).send(wish).ok();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_machines_are_refused_and_so_are_names_that_are_none() {
        let start = |bind| Web::start(bind, std::sync::mpsc::channel().0, None).err().unwrap();
        assert!(matches!(start("0.0.0.0:0"), MonitorError::NotLoopback { .. }));
        assert!(matches!(start("nonsense"), MonitorError::Address { .. }));
    }

    #[test]
    fn two_tokens_differ() {
        let (one, other) = (token().unwrap(), token().unwrap());
        assert!(one != other && one.len() == 32 && one.chars().all(|letter| letter.is_ascii_hexdigit()));
    }
}
