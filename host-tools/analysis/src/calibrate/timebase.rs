//! Compares the device's sample clock with the host's.
//!
//! Samples are numbered by the device's clock and arrive by the host's clock, always late, never early. The time is
//! divided into twelve parts; the earliest arrival in each has the least delay, and a line through these gives the
//! rate. The host's clock is only as accurate as stated, so the uncertainty is never below that.

use inerter_core::Settings;

use super::{
    CalibrateError, Finding, Step,
    finding::Level,
    statistics::{Straight, rounded_up, together},
};
use crate::law::extent;

/// Uncertainty of a host clock about which nothing is known: a computer's crystal over its temperature range.
pub const HOST_PPM: f64 = 50.0;
/// Number of parts in which the earliest arrival counts: with 60 s in total each part has a hundred batches.
const STRETCHES: f64 = 12.0;
/// Minimum number of parts with an arrival.
const LEAST: usize = 8;
/// A larger deviation is not a crystal's, or the rate differs from the setting.
const ODD: f64 = 5e-4;

/// Arrival of a batch of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Sample periods from the first sample to the last one of the batch.
    pub elapsed: u64,
    /// Host time \[ns\].
    pub time_ns: u64,
}

/// Rate of the device's clock relative to its nominal rate, minus one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Relative deviation; positive if the device is fast.
    pub deviation: f64,
    /// From the scatter of the arrivals.
    pub scatter_u95: f64,
    /// Time from the first arrival to the last \[s\].
    pub seconds: f64,
}

/// Compares sample numbers with arrival times.
pub fn rate(arrivals: &[Arrival], sample_rate_hz: f64) -> Result<Rate, CalibrateError> {
    let (Some(first), Some(last)) = (arrivals.first(), arrivals.last()) else {
        return Err(CalibrateError::TooShort { seconds: 0.0, needed: 1.0 });
    };
    let seconds_at = |arrival: &Arrival| arrival.elapsed.saturating_sub(first.elapsed) as f64 / sample_rate_hz;
    let late = |arrival: &Arrival| arrival.time_ns.saturating_sub(first.time_ns) as f64 * 1e-9 - seconds_at(arrival);
    let seconds = seconds_at(last);
    let place = |arrival: &Arrival| (seconds_at(arrival) / seconds * STRETCHES).floor();
    let earliest = arrivals.chunk_by(|one, other| place(one) == place(other)).filter_map(|part| {
        let points = part.iter().map(|arrival| (seconds_at(arrival), late(arrival)));
        points.min_by(|(_, one), (_, other)| one.total_cmp(other))
    });
    let earliest: Vec<(f64, f64)> = earliest.collect();
    let short = CalibrateError::TooShort { seconds, needed: 2.0 };
    if earliest.len() < LEAST {
        return Err(short);
    }
    let line = Straight::through(&earliest).ok_or(short)?;
    // Delays are correlated: the residuals are not white noise, and their whole range over the time is the better
    // bound.
    let range_s = extent(earliest.iter().map(|(at, late)| late - line.at(*at)));
    let scatter_u95 = line.slope_u95.max(range_s / seconds);
    // If samples arrive later and later, the device is slow.
    Ok(Rate { deviation: 1.0 / (1.0 + line.slope) - 1.0, scatter_u95, seconds })
}

/// The resulting `timebase_u95`, with the host's clock accurate to `host_ppm`.
pub fn timebase(rate: &Rate, settings: &Settings, host_ppm: f64) -> Finding {
    let mut finding = Finding::new(Step::Timebase);
    let host = host_ppm * 1e-6;
    let u95 = together([rate.scatter_u95, host]);
    // The rate is not corrected, so the whole deviation counts. Never below the uncertainty of the reference clock.
    let claim = rounded_up(rate.deviation.abs() + u95).max(host);
    let ppm = |relative: f64| relative * 1e6;
    finding.measure_all([
        ("deviation_ppm", ppm(rate.deviation)),
        ("deviation_u95_ppm", ppm(u95)),
        ("scatter_u95_ppm", ppm(rate.scatter_u95)),
        ("host_clock_ppm", host_ppm),
        ("duration_s", rate.seconds),
    ]);
    finding.say(format!(
        "the device's clock is {:.1} ppm {} than this computer's, ± {:.1} ppm: {:.1} from {:.0} s of arrival times, \
        {host_ppm:.1} from this computer's clock",
        ppm(rate.deviation).abs(),
        if rate.deviation < 0.0 { "slower" } else { "faster" },
        ppm(u95),
        ppm(rate.scatter_u95),
        rate.seconds,
    ));
    let in_use = settings.timebase_u95;
    if rate.deviation.abs() > ODD + u95 {
        finding.remark(
            Level::Bad,
            "odd_rate",
            "no crystal is that far off: it is not running (see the LED and `inerter monitor`), or sample_rate_hz is not \
            the device's",
        );
    } else if rate.deviation.abs() - u95 > in_use || claim < in_use {
        finding.set("timebase_u95", claim);
        finding
            .say(format!("timebase_u95 = {claim:?}: the deviation and its uncertainty, as the rate is not corrected"));
    } else {
        finding.say(format!(
            "nothing to change: timebase_u95 = {in_use:?} agrees, and this comparison cannot justify a value below {claim:?}"
        ));
        if rate.scatter_u95 < 0.5 * host {
            finding.remark(
                Level::Note,
                "host_clock",
                "this computer's clock is the limit: if NTP or PTP has disciplined it for hours, state its accuracy with \
                --host-clock-ppm",
            );
        }
    }
    finding
}

#[cfg(test)]
mod tests {
    use inerter_needs::Random;

    use super::*;

    /// Arrivals from a device with this clock error, each late by a pseudo-random part of `late_s`.
    fn arrivals(off: f64, late_s: f64, seconds: f64, seed: u64) -> Vec<Arrival> {
        let mut random = Random(seed);
        (0..(seconds * 20.0) as u64)
            .map(|batch| {
                let late = random.share() * late_s;
                let elapsed = batch * 50;
                let true_s = elapsed as f64 / 1000.0 / (1.0 + off);
                Arrival { elapsed, time_ns: 1_000_000_000 + ((true_s + late) * 1e9) as u64 }
            })
            .collect()
    }

    #[test]
    fn a_clock_that_is_off_is_found_within_its_interval_over_many_seeds() {
        let mut within = 0;
        for seed in 0..40 {
            let off = (seed as f64 - 20.0) * 1e-5;
            let found = rate(&arrivals(off, 4e-3, 30.0, seed), 1000.0).unwrap();
            assert!(found.scatter_u95 < 1.4e-4, "{found:?}");
            within += u32::from((found.deviation - off).abs() <= found.scatter_u95);
        }
        assert!(within >= 38, "{within}");
    }

    #[test]
    fn nothing_better_than_the_hosts_clock_is_claimed() {
        let settings = Settings::default();
        let good = rate(&arrivals(0.0, 1e-6, 60.0, 1), 1000.0).unwrap();
        assert!(good.scatter_u95 < 1e-6);
        let finding = timebase(&good, &settings, 50.0);
        assert!(!finding.has_settings() && finding.is_good());
        let finding = timebase(&good, &settings, 2.0);
        assert!(finding.values["timebase_u95"].as_f64().unwrap() >= 2e-6);
        let fast = rate(&arrivals(2e-4, 1e-6, 60.0, 1), 1000.0).unwrap();
        let finding = timebase(&fast, &settings, 50.0);
        assert!((finding.values["timebase_u95"].as_f64().unwrap() - 2.5e-4).abs() < 1.1e-5, "{finding:?}");
        let odd = rate(&arrivals(-2e-3, 1e-6, 60.0, 1), 1000.0).unwrap();
        let finding = timebase(&odd, &settings, 50.0);
        assert!(!finding.is_good() && !finding.has_settings());
        assert!(rate(&[], 1000.0).is_err() && rate(&arrivals(0.0, 0.0, 0.1, 1), 1000.0).is_err());
    }
}
