//! Reports the device's health once a second, and what it measures about itself on request.

use crate::alive::Task;
use crate::app::App;
use crate::board::Platform;
use crate::messages::Outgoing;
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Ticker};
use inerter_wire::{Measure, Quantity};

/// Time between two reports.
const PERIOD: Duration = Duration::from_secs(1);

/// Measures and reports once a second, and measures what a host requests.
pub async fn health_reports(app: &App, mut platform: impl Platform) -> ! {
    let started = Instant::now();
    let mut ticker = Ticker::every(PERIOD);
    loop {
        if let Either::Second(what) = select(ticker.next(), app.measure.wait()).await {
            let mut measured = platform.measure(what).await;
            if what == Measure::Chip {
                measured.push(Quantity::SavesLeft, app.saves_left().into());
            }
            app.urgent.send(Outgoing::Measured(measured)).await;
            app.measured.signal(());
            continue;
        }
        let figures = platform.figures();
        app.note(|health| {
            health.uptime_s = u32::try_from(started.elapsed().as_secs()).unwrap_or(u32::MAX);
            health.cpu_load_permille = figures.cpu_load_permille;
            health.stack_free_bytes = figures.stack_free_bytes;
            health.temperature_c = figures.temperature_c;
        });
        if app.streams().health {
            app.deliver(Task::Health, Outgoing::Health(app.health())).await;
        }
    }
}
