//! Diagnosis of the force channel, with the device at rest.
//!
//! The spectrum (Hann window) separates white noise, mains interference and drift. The white noise comes from the
//! spectrum's median, which neither lines nor drift affect: `sigma^2 = median / ln 2 * rate / 2`. A line's amplitude is
//! the content of its band above that floor.

use inerter_data::{names::unit, run::Run, words::amount_text};
use rustfft::{FftPlanner, num_complex::Complex};

use super::{
    CalibrateError, Finding, Step,
    finding::Level,
    statistics::{Straight, student},
    timebase::Rate,
};
use crate::law::{extent, mean, median};

/// Minimum length to distinguish mains from its surroundings \[s\].
pub const LEAST_S: f64 = 4.0;
/// Frequencies below this are drift and oscillation, not noise \[Hz\].
const LOWEST_HZ: f64 = 3.0;
/// Half width of the band that is searched for a mains line \[Hz\]: the grid's 0.2 Hz and the window's width.
const LINE_HALF_HZ: f64 = 0.75;
/// Number of harmonics that are searched.
const HARMONICS: u32 = 5;
/// Allowed white noise as a share of the range (bring-up step 6 in docs/HARDWARE.md).
const NOISE_OF_RANGE: f64 = 2e-3;
/// Mains amplitude over rms white noise that is known to be harmless: 5 N at 1 N (docs/tables/robustness.md).
const HARMLESS_MAINS: f64 = 5.0;
/// Share of the range above which mains interference reduces the usable force range.
const MAINS_OF_RANGE: f64 = 1e-2;
/// Drift per second over white noise that is known to spoil slow motion: 0.05 N/s at 1 N (docs/tables/robustness.md).
const HARMLESS_DRIFT_PER_S: f64 = 0.05;
/// Noise below which the converter's quantisation is the limit \[codes of one conversion\].
const STEPS: f64 = 0.3;
/// Share of the range that should remain on either side of zero.
const ROOM: f64 = 0.15;

/// Diagnoses the force channel of a device at rest: its state, what is wrong with it, and what to do about it. `rate`
/// is that against the host's clock, if known.
pub fn diagnose(run: &Run, rate: Option<Rate>) -> Result<Finding, CalibrateError> {
    let settings = &run.settings;
    let codes: Vec<f64> = run.samples.iter().map(|sample| f64::from(sample.force_code)).collect();
    let seconds = codes.len() as f64 / settings.sample_rate_hz;
    if seconds < 0.99 * LEAST_S {
        return Err(CalibrateError::TooShort { seconds, needed: LEAST_S });
    }
    let first = run.samples.first().map_or(0, |first| first.position_count);
    let counts = run.samples.iter().map(|sample| f64::from(sample.position_count.wrapping_sub(first)));
    let turned = extent(counts.map(|counts| counts / settings.oversampling));
    // An encoder at the edge of a count toggles by one.
    if turned > 4.0 {
        return Err(CalibrateError::Moving { at: String::new(), counts: turned });
    }
    // Everything in codes.
    let mean_code = mean(&codes);
    let squares: f64 = codes.iter().map(|code| (code - mean_code).powi(2)).sum();
    let peak_to_peak = extent(codes.iter().copied());
    let (drift, drift_u95) = drift(&codes, settings.sample_rate_hz);
    let spectrum = Spectrum::of(&codes, settings.sample_rate_hz);
    let noise = spectrum.noise();
    let [fifty, sixty] = [50.0, 60.0].map(|mains_hz| {
        let amplitudes = spectrum.mains(mains_hz);
        let together = amplitudes.iter().map(|amplitude| amplitude * amplitude).sum::<f64>().sqrt();
        (mains_hz, amplitudes, together)
    });
    let (mains_hz, amplitudes, mains) = if fifty.2 >= sixty.2 { fifty } else { sixty };
    let (_, lost) = run.discontinuities();
    let at_rail = |code: &&f64| **code <= settings.force_min_code || **code >= settings.force_max_code;
    let saturated = codes.iter().filter(at_rail).count() as f64 / codes.len() as f64;

    let mut finding = Finding::new(Step::LoadCell);
    let newtons = settings.newtons_per_code.abs();
    let range_code = settings.force_max_code - settings.force_min_code;
    let rate_hz = rate.map(|rate| settings.sample_rate_hz * (1.0 + rate.deviation));
    finding.measure_all([
        ("sample_rate_hz", rate_hz.unwrap_or(f64::NAN)),
        ("stated_sample_rate_hz", settings.sample_rate_hz),
        ("duration_s", seconds),
        ("lost_samples", lost as f64),
        ("saturated", saturated),
        ("mean_code", mean_code),
        ("noise_code", noise),
        ("noise_n", noise * newtons),
        ("rms_n", (squares / codes.len() as f64).sqrt() * newtons),
        ("drift_n_per_s", drift * newtons),
        ("drift_u95_n_per_s", drift_u95 * newtons),
        ("mains_hz", if mains > 0.0 { mains_hz } else { f64::NAN }),
        ("mains_n", mains * newtons),
        ("range_n", range_code * newtons),
        ("peak_to_peak_of_range", peak_to_peak / range_code),
    ]);
    let by_host = rate_hz.map_or_else(String::new, |rate| format!(", {rate:.1} by this computer's clock"));
    finding.say(format!("{:.0} samples a second stated{by_host}; {lost} lost", settings.sample_rate_hz));
    let unit = unit(settings.machine, "N");
    let amount = |code: f64, decimals| amount_text(code * newtons, decimals);
    finding.say(format!(
        "noise {} {unit} rms per sample ({noise:.2} codes), drift {}{} ± {} {unit}/s, range ±{} {unit}",
        amount(noise, 4),
        if drift < 0.0 { "" } else { "+" },
        amount(drift, 4),
        amount(drift_u95, 4),
        amount(0.5 * range_code, 0)
    ));
    finding.say(if mains > 0.0 {
        let each: Vec<String> = amplitudes.iter().map(|code| amount(*code, 3)).collect();
        format!(
            "mains {} {unit} in amplitude at {mains_hz:.0} Hz and harmonics ({} {unit})",
            amount(mains, 4),
            each.join(", ")
        )
    } else {
        "no mains pickup".into()
    });

    if saturated > 0.0 {
        finding.remark(
            Level::Bad,
            "saturated",
            "the code is at its limit: a wire of the cell is loose, the cell is overloaded, or the gain is too high",
        );
        return Ok(finding);
    }
    if peak_to_peak == 0.0 {
        finding.remark(
            Level::Bad,
            "dead",
            "the code never changes: the converter does not run, or its input is shorted",
        );
        return Ok(finding);
    }
    if let Some(rate) = rate.filter(|rate| rate.deviation.abs() > 1e-3 + rate.scatter_u95) {
        finding.remark(Level::Bad, "rate", format!(
            "the sample rate is {:.2} % off that stated: sample_rate_hz is not the device's, or its crystal does not run",
            100.0 * rate.deviation
        ));
    }
    if lost > 0 {
        finding.remark(
            Level::Doubtful,
            "lost",
            format!("{lost} samples were lost: shorten the cable, use USB, or close other programs"),
        );
    }
    if noise > NOISE_OF_RANGE * range_code {
        finding.remark(Level::Bad, "noise", format!(
            "noise is {:.2} % of the range; 0.2 % is usual: check the cable's screen, the ground and the cell's supply",
            100.0 * noise / range_code
        ));
    }
    if noise < STEPS * settings.oversampling.sqrt() {
        finding.remark(Level::Doubtful, "gain", format!(
            "the noise is below one step of the converter ({} {unit}): the gain is too low, and the steps limit the resolution",
            amount_text(newtons, 4)
        ));
    }
    let takes_room = mains > MAINS_OF_RANGE * range_code;
    if takes_room || mains > HARMLESS_MAINS * noise && mains > STEPS {
        let level = if takes_room { Level::Bad } else { Level::Doubtful };
        finding.remark(level, "mains", format!(
            "mains pickup is {:.1} times the noise (up to {HARMLESS_MAINS:.0} is harmless): ground the cable's screen at \
             one end only, keep it away from drives, and use a USB isolator where grounds differ",
            mains / noise
        ));
    }
    if drift.abs() > HARMLESS_DRIFT_PER_S * noise + drift_u95 {
        finding.remark(
            Level::Doubtful,
            "drift",
            "the zero drifts: let cell and amplifier warm up for a quarter of an hour, and keep draughts off; \
             slow motion is affected first",
        );
    }
    let room = (mean_code - settings.force_min_code).min(settings.force_max_code - mean_code) / range_code;
    if room < ROOM {
        finding.remark(
            Level::Doubtful,
            "off_centre",
            format!("only {:.0} % of the range is left on one side: adjust the amplifier's offset", 100.0 * room),
        );
    }
    if finding.remarks.is_empty() {
        finding.say("no fault found");
    }
    Ok(finding)
}

/// Slope of the means of twelve blocks, so that correlation within a block does not reduce the uncertainty.
fn drift(codes: &[f64], rate_hz: f64) -> (f64, f64) {
    let length = (codes.len() / 12).max(1);
    let blocks = codes.chunks_exact(length).enumerate();
    let means: Vec<(f64, f64)> = blocks
        .map(|(place, block)| {
            let middle_s = (place as f64 + 0.5) * length as f64 / rate_hz;
            (middle_s, mean(block))
        })
        .collect();
    let line = Straight::through(&means).unwrap_or_default();
    (line.slope, if line.slope_u95.is_finite() { line.slope_u95 } else { student(1) * line.slope.abs() })
}

/// One-sided power spectral density of the codes.
struct Spectrum {
    density: Vec<f64>,
    spacing_hz: f64,
    floor: f64,
}

impl Spectrum {
    fn of(codes: &[f64], rate_hz: f64) -> Self {
        let count = codes.len();
        let mean = mean(codes);
        let turn = std::f64::consts::TAU / count as f64;
        let window = |place: usize| 0.5 - 0.5 * (turn * place as f64).cos();
        let mut values: Vec<Complex<f64>> =
            codes.iter().enumerate().map(|(place, code)| Complex::new((code - mean) * window(place), 0.0)).collect();
        FftPlanner::new().plan_fft_forward(count).process(&mut values);
        // The mean square of the window is 3/8.
        let scale = 2.0 / (rate_hz * 0.375 * count as f64);
        let density: Vec<f64> = values.iter().take(count / 2).map(|value| value.norm_sqr() * scale).collect();
        let spacing_hz = rate_hz / count as f64;
        let lowest = (LOWEST_HZ / spacing_hz).ceil() as usize;
        let floor = median(density.iter().skip(lowest).copied().collect()).unwrap_or(0.0) / std::f64::consts::LN_2;
        Self { density, spacing_hz, floor }
    }

    /// White noise of one sample, rms.
    fn noise(&self) -> f64 {
        (self.floor * self.spacing_hz * self.density.len() as f64).sqrt()
    }

    /// Amplitude of a grid's frequency and of each harmonic below half the sample rate.
    fn mains(&self, frequency_hz: f64) -> Vec<f64> {
        let half_rate_hz = self.spacing_hz * self.density.len() as f64;
        let below = (1..=HARMONICS).map(|harmonic| f64::from(harmonic) * frequency_hz);
        let lines = below.take_while(|line_hz| line_hz + LINE_HALF_HZ < half_rate_hz);
        lines.map(|line_hz| self.line(line_hz)).collect()
    }

    /// Amplitude of a line; zero if the band holds no more than chance explains.
    fn line(&self, line_hz: f64) -> f64 {
        let first = ((line_hz - LINE_HALF_HZ) / self.spacing_hz).ceil().max(0.0) as usize;
        let last = ((line_hz + LINE_HALF_HZ) / self.spacing_hz).floor() as usize;
        let band = self.density.iter().skip(first).take(last.saturating_sub(first) + 1);
        let (sum, bins) = band.fold((0.0, 0.0), |(sum, bins), density| (sum + density, bins + 1.0));
        let above = sum - self.floor * bins;
        // The window correlates adjacent bins: half as many are independent.
        let by_chance = 5.0 * self.floor * f64::sqrt(2.0 * bins);
        if above > by_chance { (2.0 * above * self.spacing_hz).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
#[path = "load_cell_tests.rs"]
mod tests;
