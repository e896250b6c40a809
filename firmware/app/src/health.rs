//! How the device is doing, once a second.

use crate::alive::Task;
use crate::app::App;
use crate::board::Platform;
use crate::messages::Outgoing;
use embassy_time::{Duration, Instant, Ticker};

/// Time between two reports.
const PERIOD: Duration = Duration::from_secs(1);

/// Measures and reports once a second.
pub async fn health_reports(app: &App, mut platform: impl Platform) -> ! {
    let started = Instant::now();
    let mut ticker = Ticker::every(PERIOD);
    loop {
        ticker.next().await;
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
