//! The app on mock parts: as a host sees it over the link, and its store on flash that fails.

mod alive;
mod flash;
mod instrument;
mod rig;
mod source;
mod start;
mod store;
