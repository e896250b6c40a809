//! `inerter replay --store`: arguments; its work is in `tables/replay.rs`.

use super::tables::values::Shard;

/// Runs of a store instead of a file.
#[derive(clap::Args)]
pub struct StoreArgs {
    /// Replay the runs of this store, and keep the results in its batch
    #[arg(long, value_name = "STORE", conflicts_with_all = ["limits", "every"], help_heading = "Store")]
    pub store: Option<String>,
    /// Replay a part of its runs: 3/100 is the third of a hundred parts, the same for every caller
    #[arg(long, value_name = "N/OF", requires = "store", help_heading = "Store")]
    pub shard: Option<Shard>,
    /// Name of the batch: letters, digits, - and _
    #[arg(long, value_name = "NAME", default_value = "replay", requires = "store", help_heading = "Store")]
    pub batch: String,
    /// Also replay what the batch already has
    #[arg(long, requires = "store", help_heading = "Store")]
    pub again: bool,
}
