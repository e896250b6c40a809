//! libFuzzer on requests by HTTP and WebSocket.
#![no_main]

inerter_fuzz::target!(requests);
