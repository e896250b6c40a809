//! The wire crate as its users see it, on bytes and values alone.

mod catalogue;
mod corruption;
mod echo;
mod golden;
mod reader;
mod reference;
mod samples;
mod settings;
mod specification;
mod values;
