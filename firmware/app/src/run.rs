//! All tasks in one future.

use crate::app::App;
use crate::board::{Board, Platform, SampleSource, Store};
use crate::commands::commands;
use crate::estimating::estimating;
use crate::health::health_reports;
use crate::messages::Restart;
use crate::sampling::sampling;
use crate::settings::load_settings;
use crate::telemetry::telemetry;
use embassy_futures::join::join4;
use embassy_futures::select::{Either, select};
use embedded_io_async::{Read, Write};
use inerter_core::{SettingsError, State};

/// Runs the instrument until a host requests a restart, which the caller executes.
///
/// Fails only if the board's default settings are invalid.
pub async fn run<S, R, W, K, P>(
    app: &App,
    state: &mut State,
    board: Board<'_, S, R, W, K, P>,
) -> Result<Restart, SettingsError>
where
    S: SampleSource,
    R: Read,
    W: Write,
    K: Store,
    P: Platform,
{
    let Board { source, receiver, transmitter, mut store, platform, identity, defaults, autostart } = board;
    let (mut in_use, mut active) = load_settings(&mut store, &identity, &defaults).await?;
    let endless = join4(
        sampling(app, source),
        estimating(app, state, &mut active),
        commands(app, receiver, store, &identity, &mut in_use, autostart),
        health_reports(app, platform),
    );
    match select(telemetry(app, transmitter), endless).await {
        Either::First(restart) => Ok(restart),
        Either::Second((never, ..)) => never,
    }
}
