//! The wire crate as its users see it, tested on bytes and values alone.

mod catalogue;
mod corruption;
mod device;
mod echo;
mod frames;
mod golden;
mod reader;
mod reference;
mod samples;
mod settings;
mod specification;
mod values;
