//! Stores: the work of `inerter store` and `inerter replay --store`, whose arguments are beside this module. All of it
//! is behind the feature `tables`.

mod replay;
mod store;
pub mod values;

pub use replay::run as replay;
pub use store::run as store;
