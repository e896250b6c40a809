//! A plan, for a person and for a program.

use inerter_core::{Backlash, Machine};
use inerter_data::{
    csv::motion::Point,
    json::BacklashJson,
    names::{description, parameter, unit},
    text::backlash_text,
    uncertainty::{PartJson, parts, source_word},
    wants::Want,
    words::{code, duration_text, rounded_text, three_digits},
};
use inerter_plant::Inerter;
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{
    design::Plan,
    error::PlanError,
    part::Part,
    predict::{Predicted, Prediction},
    words::{digits, interval_of, limits_text, part_text, peaks_text, source_words},
};

/// Ratio of the scatter to what the interval covers above which it is reported.
const SCATTERS: f64 = 1.3;
/// Fraction of rehearsals with a broken law above which it is reported.
const BREAKS: f64 = 0.1;

impl Plan {
    fn machine(&self) -> Machine {
        self.expected.settings.machine
    }

    /// The points of the motion at this rate, from rest to rest.
    pub fn points(&self, rate_hz: f64) -> impl Iterator<Item = Point> {
        let count = (self.duration_s * rate_hz).ceil() as u64;
        (0..=count).map(move |k| {
            let t_s = k as f64 / rate_hz;
            let at = self.motion.at(t_s);
            Point { t_s, terminal_m: at.x_m, velocity_m_per_s: at.v_m_per_s, acceleration_m_per_s2: at.a_m_per_s2 }
        })
    }

    /// The stroke of the rig, or of the motion if none was stated \[m\].
    pub fn stroke_m(&self) -> f64 {
        let (stated_m, peak_m) = (self.stated.stroke_m, self.prediction.peaks.stroke_m);
        if stated_m.is_finite() { stated_m.max(peak_m) } else { peak_m }
    }

    /// Wanted intervals that are out of reach, and why; `None` if there are none.
    pub fn missed(&self) -> Option<PlanError> {
        let missed: Vec<&Want> = self.wants.iter().filter(|want| self.reached(want) > want.u95).collect();
        let want = missed.first()?;
        // If no time is enough, only what does not average out matters.
        let first = self.of(want).most(self.enough_s(want).is_some());
        let all: Vec<String> = missed.iter().map(|want| self.missed_text(want)).collect();
        Some(PlanError::Missed {
            what: format!("out of reach: {}", all.join("; ")),
            help: format!("the largest part is {}", source_words(self.machine(), first)),
        })
    }

    /// Why a wanted interval cannot be reached.
    fn missed_text(&self, want: &Want) -> String {
        let reached = self.reached(want);
        let wanted = interval_of(self.machine(), want.place, want.u95);
        let symbol = parameter(self.machine(), want.place).symbol;
        match self.enough_s(want) {
            _ if !reached.is_finite() => format!("{wanted}: this motion gives no value"),
            Some(seconds) => format!(
                "{wanted}: ± {} is the best within {}, about {} would suffice",
                rounded_text(reached, reached),
                duration_text(self.duration_s),
                duration_text(seconds)
            ),
            None => {
                let floor = rounded_text(self.floor(want), self.floor(want));
                format!("{wanted}: no duration suffices, as ± {floor} of {symbol} does not average out")
            }
        }
    }

    /// Remarks for a person, besides the numbers.
    pub fn remarks(&self) -> Vec<String> {
        let (expected, machine) = (&self.expected, self.machine());
        let Prediction { parameters, peaks, broken, .. } = &self.prediction;
        let mut remarks = Vec::new();
        if self.given.is_some() && self.limits.room(peaks) < 1.0 {
            let limits = limits_text(machine, &self.stated);
            remarks
                .push(format!("this motion exceeds the limits of {limits}: it needs {}", peaks_text(machine, peaks)));
        }
        if *broken > BREAKS {
            let part = 100.0 * broken;
            remarks.push(format!(
                "in {part:.0} % of the rehearsals the law is judged broken: expect wider intervals, or none"
            ));
        }
        for (place, predicted) in parameters.iter().enumerate().take(3) {
            let stands_for = predicted.same_rig_u95() / 1.96;
            if predicted.is_given() && predicted.scatter > SCATTERS * stands_for {
                let field = parameter(machine, place);
                remarks.push(format!(
                    "{} will scatter by {} {}, more than its interval covers: the encoder's steps are a large part of this motion",
                    field.symbol,
                    three_digits(predicted.scatter),
                    field.unit
                ));
            }
        }
        if self.duration_s > expected.settings.memory_s {
            remarks.push(format!(
                "the law is judged over the last memory_s = {} s only: with {:.0} intervals of the whole run may be narrower",
                expected.settings.memory_s,
                self.duration_s.ceil()
            ));
        }
        remarks
    }

    /// The comments above the points of a file.
    pub fn comments(&self) -> Vec<String> {
        let mut comments = vec![format!("inerter plan {}: {}", env!("CARGO_PKG_VERSION"), self.heading())];
        comments.extend(self.lines());
        comments
    }

    fn heading(&self) -> String {
        let time = duration_text(self.duration_s);
        if let Some(text) = &self.given {
            return format!("motion `{text}` of {time}");
        }
        let why = if self.is_wanted { "as short as the wanted intervals allow" } else { "D-optimal for mt, cf and fc" };
        format!("motion of {time} within {}, {why}", limits_text(self.machine(), &self.limits))
    }

    fn lines(&self) -> Vec<String> {
        let line = |part: &Part| {
            let fade = three_digits(part.fade_s);
            format!(
                "{:>8} of {}, faded in and out within {fade} s",
                duration_text(part.duration_s),
                part_text(self.machine(), part)
            )
        };
        self.parts.iter().map(line).collect()
    }

    /// For a person.
    pub fn text(&self) -> Vec<String> {
        let (expected, machine) = (&self.expected, self.machine());
        let mut text = vec![self.heading()];
        text.extend(self.lines().into_iter().map(|line| format!("  {line}")));
        text.push(format!("it needs {} from the rig", peaks_text(machine, &self.prediction.peaks)));
        text.push(String::new());
        text.push(format!(
            "{:<20} {:<6} {:<10} {:<10} {:<10} {:<10} {}",
            "", "", "expected", "U95", "same rig", "scatter", "largest part"
        ));
        for (place, predicted) in self.prediction.parameters.iter().enumerate() {
            text.push(row(machine, place, predicted));
        }
        let backlash = expected.device.backlash_m * 1e6;
        text.push(format!(
            "{:<20} {:<6} {:<10} {}",
            description(machine, "Backlash"),
            unit(machine, "µm"),
            three_digits(backlash),
            backlash_words(&self.prediction.backlash)
        ));
        for want in &self.wants {
            let reached = self.reached(want);
            let verdict = match (reached <= want.u95, reached.is_finite()) {
                (true, _) => format!("reached, ± {}", rounded_text(reached, reached)),
                (false, true) => format!("not reached, ± {}", rounded_text(reached, reached)),
                (false, false) => "not reached, no value".into(),
            };
            text.push(format!("wanted: {}: {verdict}", interval_of(machine, want.place, want.u95)));
        }
        text
    }

    /// For a program, with the names of a linear machine; `files` are those that it was written to. What is infinite
    /// is null in JSON.
    pub fn json<F: Serialize>(&self, files: &[F]) -> Value {
        let expected = &self.expected;
        let Prediction { parameters, backlash, peaks, band_hz, bank, broken } = &self.prediction;
        let name = |place: usize| parameter(Machine::Linear, place).path;
        let predicted: Map<String, Value> = parameters
            .iter()
            .enumerate()
            .map(|(place, predicted)| (name(place).to_string(), predicted_json(place, predicted)))
            .collect();
        let want = |want: &Want| {
            let reached = self.reached(want);
            json!({
                "parameter": name(want.place), "wanted": want.u95, "reached": reached,
                "is_reached": reached <= want.u95, "floor": self.floor(want), "enough_s": self.enough_s(want),
            })
        };
        let device: Map<String, Value> = Inerter::TABLE
            .iter()
            .zip(expected.device.values())
            .map(|(field, value)| (field.name.to_string(), value.into()))
            .collect();
        json!({
            "kind": "plan",
            "criterion": match self.given {
                Some(_) => "given",
                None if self.is_wanted => "wanted",
                None => "d_optimal",
            },
            "duration_s": self.duration_s,
            "motion": self.given,
            "parts": self.parts.iter().map(Part::json).collect::<Vec<_>>(),
            "limits": self.stated,
            "peaks": peaks,
            "expected": device,
            "force_noise_n": expected.force_noise_n,
            "predicted": predicted,
            "backlash_m": BacklashJson::from(*backlash),
            "bank": code(bank),
            "band_hz": band_hz,
            "broken": broken,
            "wants": self.wants.iter().map(want).collect::<Vec<_>>(),
            "files": files,
        })
    }
}

/// The prediction for a parameter, in JSON.
fn predicted_json(place: usize, predicted: &Predicted) -> Value {
    let known = |value: f64| predicted.is_given().then_some(value);
    let status = match (predicted.is_given(), predicted.is_shown()) {
        (false, _) => "not_identifiable",
        // For an offset zero is as good a result as any.
        (true, false) if place < 3 => "below_u95",
        (true, _) => "ok",
    };
    let most = predicted.is_given().then(|| source_word(predicted.most(true)));
    let part = |(source, u95)| PartJson { source: source_word(source), u95 };
    json!({
        "value": predicted.value,
        "u95": predicted.u95(),
        "same_rig_u95": predicted.same_rig_u95(),
        "u_a": known(predicted.u_a()),
        "scatter": known(predicted.scatter),
        "given": predicted.given,
        "status": status,
        "most": most,
        "budget": parts(&predicted.budget).map(part).collect::<Vec<_>>(),
    })
}

/// A row of the table for a person.
fn row(machine: Machine, place: usize, predicted: &Predicted) -> String {
    let field = parameter(machine, place);
    let expected = match predicted.value.abs() {
        0.0 => "0".into(),
        value if value < 1e-2 => format!("{:.3e}", predicted.value),
        // Four digits.
        value => rounded_text(predicted.value, 0.01 * value),
    };
    let begin = format!("{:<20} {:<6} {expected:<10}", field.label, field.unit);
    if !predicted.is_given() {
        let part = (predicted.given * 100.0).round();
        return format!("{begin} not identifiable: a value in {part} % of the rehearsals");
    }
    let below = if place < 3 && !predicted.is_shown() { " (may be none)" } else { "" };
    let source = source_words(machine, predicted.most(true));
    let source = source.split_once(':').map_or(source.as_str(), |(what, _)| what).to_string();
    format!(
        "{begin} {:<10} {:<10} {:<10} {source}{below}",
        format!("± {}", digits(predicted.u95())),
        format!("± {}", digits(predicted.same_rig_u95())),
        digits(predicted.scatter),
    )
}

/// The prediction for the backlash: its interval, or why there is none.
fn backlash_words(backlash: &Backlash) -> String {
    match backlash.known() {
        Some(known) => format!("± {}", rounded_text(f64::from(known.u95) * 1e6, f64::from(known.u95) * 1e6)),
        None => backlash_text(backlash),
    }
}
