//! The app on mock parts: as seen by a host over the link, and its store on failing flash.

mod alive;
mod flash;
mod instrument;
mod rig;
mod source;
mod start;
mod store;
