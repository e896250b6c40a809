//! `cargo xtask coverage`: width and coverage of the intervals if the law is true, and coverage if it is nearly true.

use inerter_analysis::diagnose::{TOLD, reach};
use inerter_core::{Interval, NORMAL_COVERAGE};
use inerter_data::uncertainty::source_word;
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    backlash,
    coverage::{Bench, Cell, RIGHT, STATED, cells},
    grid::{self, Error, MOTIONS, Motion, NAMES, RIGS, each, error, motion, sensors},
    nearly::{WANTED, sections},
    sheet::{self, significant},
};
use inerter_view::figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke, svg};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use std::{f64::consts::TAU, ops::RangeInclusive};

/// First seed and number of the runs that count. Runs 1 to 100 on the first bench determined the share of the encoder's
/// steps.
const SEEDS: (u64, u64) = (1001, 400);
/// First seed and number of runs for a law that is nearly true.
const NEARLY: (u64, u64) = (2001, 40);
/// First seed and number of runs for tones with a whole number of samples per period.
const TONES: (u64, u64) = (4001, 200);
/// First seed and number of runs for the contact.
const CONTACT: (u64, u64) = (3001, 60);
/// Required coverage if settings are wrong by their stated uncertainty \[%\].
const HELD: RangeInclusive<f64> = 93.0..=97.0;
/// Number of random draws for the frontier.
const DRAWN: usize = 20_000;
/// Half width of a normal 95 % interval in standard errors.
const K: f64 = NORMAL_COVERAGE as f64;

/// The grid's benches, and the first with another clock.
fn benches() -> impl Iterator<Item = Bench> {
    let [first, others @ ..] = grid::benches(sensors());
    let (_, paper, sensors) = first;
    let clock = Sensors { sample_rate_hz: 1000.01, ..sensors };
    let all = [first, ("the same, its clock 10 ppm faster than the shaker's", paper, clock)].into_iter().chain(others);
    all.map(|(name, device, sensors)| Bench { name, device, sensors, wrong: &[] })
}

pub fn run(words: &[&str]) -> Result<bool, Error> {
    let asked = sheet::asked("coverage", words)?;
    let update = asked == sheet::Asked::Update;
    let (first, seeds) = SEEDS;
    let mut text = format!(
        "# Coverage

`cargo xtask coverage --update` writes this table. It shows how sharp `U95` over the whole run is, and how often it holds, when everything that the settings
state is exactly true: {seeds} runs of each motion of [accuracy](accuracy.md), seeds from {first} on.

- *rms*: root mean square of the error over `U95`. An interval that is right has 0.51; {} to {} is wanted. *covered*: runs whose interval holds the truth.
- A cell is bold where less than 95 % are covered beyond chance (1 in 10 000), or the rms lies outside beyond chance. *broken*: runs in which the law is called broken in the end.
",
        RIGHT.start(),
        RIGHT.end()
    );
    let (mut right, mut blunt, mut all) = (0, 0, 0);
    for bench in benches() {
        text += &format!(
            "\n## {}\n\n| motion | parameter | U95 | rms | covered % | broken |\n|---|---|--:|--:|--:|--:|\n",
            bench.name
        );
        for motion in MOTIONS.iter().filter(|motion| motion.name != "slow" || bench.sensors.sample_rate_hz < 2000.0) {
            eprintln!("{}: {}", bench.name, motion.name);
            let runs = bench.runs(motion, first, seeds)?;
            let broken = runs.iter().filter(|(_, broken)| *broken).count();
            for (cell, name) in cells(&runs).into_iter().zip(NAMES) {
                all += 1;
                right += usize::from(!cell.is_wrong());
                blunt += usize::from(cell.is_blunt());
                text += &row(motion, name, &cell, broken);
            }
        }
    }
    text += &format!("\n{right} of {all} cells are right. In {blunt} more than 95 % are covered beyond chance.\n");
    text += &tones()?;
    text += &contacts()?;
    text += &stated()?;
    text += &frontier(update)?;
    text += &nearly(update)?;
    print!("{text}");
    sheet::conclude("coverage", &text, 2, asked)
}

/// Tones whose period is a whole number of samples, or nearly.
fn tones() -> Result<String, Error> {
    let (first, seeds) = TONES;
    let mut text = format!(
        "
## Tones of a whole number of samples

The first bench, {seeds} runs of each tone with amplitudes within 15 % of the speed's, seeds from {first} on. The shaker's clock is the instrument's own, so that each period reads the same counts, or the instrument's is 10 ppm faster. *rms* is
that of the error over `U95`, *%* the runs whose interval holds the truth.

| Hz | mm/s | clock | mt: U95 kg | rms | % | cf: U95 N s/m | rms | % | fc: U95 N | rms | % |
|--:|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|
"
    );
    for hz in [2.0, 5.0, 8.0, 10.0, 12.5] {
        for mm_per_s in [30.0, 80.0] {
            for (clock, ppm) in [("its own", 0.0), ("10 ppm", 10.0)] {
                eprintln!("tone: {hz} Hz, {mm_per_s} mm/s, {clock}");
                let sample_rate_hz = sensors().sample_rate_hz * (1.0 + 1e-6 * ppm);
                let sensors = Sensors { sample_rate_hz, ..sensors() };
                let bench = Bench { name: "tones", device: Inerter::paper(), sensors, wrong: &[] };
                let runs = each(1..=seeds, |seed| {
                    let part = 0.85 + 0.3 * ((seed as f64 * 0.7549) % 1.0);
                    let motion = format!("sine:{hz}Hz:{}mm", part * mm_per_s / (TAU * hz));
                    bench.run(&motion, 20.0, first + seed - 1)
                })?;
                let figures = cells(&runs).into_iter().flat_map(|cell| figures(&cell, 0));
                text += &sheet::row(&[&hz.to_string(), &mm_per_s.to_string(), clock], figures);
            }
        }
    }
    Ok(text)
}

/// Backlash, stiffness and damping of the contact, on a rig with true settings.
fn contacts() -> Result<String, Error> {
    let (first, seeds) = CONTACT;
    let mut text = format!(
        "
## Contact

Backlash by the force alone, with a stiffness that is known to 0.1 %; and by the terminal's sensor, with stiffness and damping: {seeds} runs of each motion, seeds from {first} on, all else that the settings state true to the last
digit. U95 of a backlash in um, the others in per cent. Runs without a value are not counted.
"
    );
    let mut all: Vec<Cell> = Vec::new();
    for rig in [&RIGS[0], &RIGS[RIGS.len() - 1]] {
        text += &format!(
            "\n### Contact, {}\n\n| motion | backlash um | by force: U95 | rms | covered % | by sensor: U95 | rms | covered % | stiffness: U95 % | rms | covered % | damping: U95 % | rms | covered % |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n",
            rig.name
        );
        for motion in &MOTIONS {
            for backlash_m in [0.0, 20e-6, 100e-6] {
                eprintln!("contact: {} {} {:.0} um", rig.name, motion.name, backlash_m * 1e6);
                let device = Inerter { backlash_m, ..Inerter::paper() };
                let shaken = |seed| backlash::run(&device, motion.name, motion.duration_s, rig, seed);
                let runs = each(first..first + seeds, shaken)?;
                let mut of = |read: fn(&backlash::Run) -> Option<Interval>, truth: f64, unit: f64| {
                    let found = runs.iter().filter_map(read);
                    let errors: Vec<(f64, f64)> = found.map(|found| error(found, truth)).collect();
                    if errors.is_empty() {
                        return ["-".to_string(), "-".into(), "-".into()];
                    }
                    let cell = Cell::of(&errors);
                    all.push(cell);
                    [significant(cell.u95 * unit), format!("{:.2}", cell.rms), format!("{:.1}", covered_percent(&cell))]
                };
                let (stiffness, damping) = (device.stiffness_n_per_m, device.contact_damping_n_s_per_m);
                let figures = [
                    of(|run| run.force.backlash.known(), backlash_m, 1e6),
                    of(|run| run.sensed.backlash.known(), backlash_m, 1e6),
                    of(|run| run.sensed.stiffness_n_per_m.known(), stiffness, 100.0 / stiffness),
                    of(|run| run.sensed.contact_damping_n_s_per_m.known(), damping, 100.0 / damping),
                ];
                text += &sheet::row(&[motion.name, &format!("{:.0}", backlash_m * 1e6)], figures.into_iter().flatten());
            }
        }
    }
    let count = |which: &dyn Fn(&Cell) -> bool| all.iter().filter(|cell| which(cell)).count();
    text += &format!(
        "\nIn {} cells at least {:.1} % are covered. The rms is over {} in {} of them, and under {} in {}.\n",
        all.len(),
        all.iter().map(covered_percent).fold(f64::INFINITY, f64::min),
        RIGHT.end(),
        count(&|cell| cell.rms > *RIGHT.end()),
        RIGHT.start(),
        count(&|cell| cell.rms < *RIGHT.start()),
    );
    Ok(text)
}

/// Settings that are wrong by their stated uncertainty.
fn stated() -> Result<String, Error> {
    let (first, seeds) = SEEDS;
    let chance = 196.0 * (0.95 * 0.05 / seeds as f64).sqrt();
    let mut text = format!(
        "
## Settings that are wrong by what they state

Monte Carlo after JCGM 101: in each of {seeds} runs of the first bench the settings are wrong by a normal error of the size that they state, one source at a time, then all. Stated as 95 % are 0.5 % of
the force's gain, 0.2 % of the lead, 0.1 % of the timebase, 20 us of skew, 0.1 kg of the structure's 1.5, 20 % of the contact's stiffness. 95 % of so many runs are {:.1} to {:.1} % by chance.

| wrong | motion | broken | mt: U95 | rms | covered % | cf: U95 | rms | covered % | fc: U95 | rms | covered % |
|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|
",
        95.0 - chance,
        95.0 + chance
    );
    let (mut by_one, mut by_all) = (Vec::new(), Vec::new());
    let alone = STATED.iter().map(|source| (source_word(*source), std::slice::from_ref(source)));
    for (name, wrong) in alone.chain([("all", &STATED[..])]) {
        let bench = Bench { name, device: Inerter::paper(), sensors: sensors(), wrong };
        for motion in ["fast", "random", "two"].map(motion) {
            eprintln!("{name}: {}", motion.name);
            let runs = bench.runs(motion, first, seeds)?;
            let found = cells(&runs);
            let covered = if wrong.len() == 1 { &mut by_one } else { &mut by_all };
            covered.extend(found.iter().map(covered_percent));
            let broken = runs.iter().filter(|(_, broken)| *broken).count().to_string();
            let figures = found.iter().flat_map(|cell| figures(cell, 1));
            text += &sheet::row(&[name, motion.name, &broken], figures);
        }
    }
    for (wrong, covered) in [("By single sources", by_one), ("With all together", by_all)] {
        let extremes =
            covered.iter().fold((100.0_f64, 0.0_f64), |(least, most), one| (least.min(*one), most.max(*one)));
        text += &format!(
            "\n{wrong} {} of {} cells are within {} to {} %, {} under and {} over it: {:.1} to {:.1} %.\n",
            covered.iter().filter(|one| HELD.contains(one)).count(),
            covered.len(),
            HELD.start(),
            HELD.end(),
            covered.iter().filter(|one| *one < HELD.start()).count(),
            covered.iter().filter(|one| *one > HELD.end()).count(),
            extremes.0,
            extremes.1,
        );
    }
    Ok(text)
}

/// Half width, rms, and covered runs with this number of decimals \[%\]: bold where they are too few.
fn figures(cell: &Cell, decimals: usize) -> [String; 3] {
    let covered = format!("{:.decimals$}", covered_percent(cell));
    let bold = if cell.is_low() { format!("**{covered}**") } else { covered };
    [significant(cell.u95), format!("{:.2}", cell.rms), bold]
}

fn covered_percent(cell: &Cell) -> f64 {
    100.0 * cell.covered as f64 / cell.given as f64
}

fn row(motion: &Motion, name: &str, cell: &Cell, broken: usize) -> String {
    let bold = |text: String| if cell.is_wrong() { format!("**{text}**") } else { text };
    sheet::line([
        motion.name.into(),
        name.into(),
        significant(cell.u95),
        bold(format!("{:.2}", cell.rms)),
        bold(format!("{:.1}", covered_percent(cell))),
        broken.to_string(),
    ])
}

/// Two independent standard normal errors: the error of the law's own estimate, and that of the size of a cause.
struct Draws(Vec<[f64; 2]>);

impl Draws {
    fn new() -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        Self((0..DRAWN).map(|_| [(); 2].map(|()| StandardNormal.sample(&mut random))).collect())
    }

    /// Lowest coverage of an interval over all sizes of a cause, if the estimate of its size scatters by `chance`
    /// \[%\]. `by` maps the errors and a size to deviation and half width of the interval.
    fn least_held(&self, chance: f64, by: &dyn Fn([f64; 2], f64) -> (f64, f64)) -> f64 {
        let held = |size: f64| {
            let within = self.0.iter().filter(|draw| {
                let (error, half_width) = by(**draw, size);
                error.abs() <= half_width
            });
            100.0 * within.count() as f64 / DRAWN as f64
        };
        (0..=60).map(|step| held(f64::from(step) * chance.max(1.0) * 0.25)).fold(100.0, f64::min)
    }

    /// Coverage of `replay`'s interval, and its mean width relative to the law's own interval, with the share for a
    /// cause multiplied by `times`.
    fn replay(&self, chance: f64, times: f64) -> (f64, f64) {
        let half_width = |other: f64, size: f64| K.hypot(times * reach(size + chance * other, chance));
        let held = self.least_held(chance, &|[own, other], size| (own + size, half_width(other, size)));
        let width = self.0.iter().map(|[_, other]| half_width(*other, 0.0)).sum::<f64>() / DRAWN as f64 / K;
        (held, width)
    }
}

/// Scatter of the size of a cause that is fitted together with the law, if this increases the law's standard error by
/// the factor `grows`.
fn chance(grows: f64) -> f64 {
    (grows * grows - 1.0).sqrt()
}

/// The cost of covering an omitted cause of any size, as a function of the increase in standard error when the cause is
/// fitted too. In units of the law's standard error.
fn frontier(update: bool) -> Result<String, Error> {
    let draws = Draws::new();
    let mut text = format!(
        "
## Frontier

A cause that the law does not model can move a parameter by any amount; the run estimates that amount with a random error. Errors are normal, {DRAWN} draws a size; [a figure](frontier.svg). *held*: least part of the truths that the
interval holds, over all sizes; *width*: its mean where there is no such cause, over that of the law's own. *replay*: the interval of `replay`; *beside*: the law fitted with the cause beside it, which is unbiased.

| the standard error grows by | law alone: held % | replay: held % | width | beside: held % | width |
|--:|--:|--:|--:|--:|--:|
"
    );
    for grows in [1.05_f64, 1.1, 1.25, 1.5, TOLD, 2.5, 4.0] {
        let chance = chance(grows);
        let alone = draws.least_held(chance, &|[own, _], size| (own + size, K));
        let (ours, width) = draws.replay(chance, 1.0);
        let beside = draws.least_held(chance, &|[own, other], _| (own - chance * other, K * grows));
        text += &sheet::line([
            grows.to_string(),
            format!("{alone:.0}"),
            format!("{ours:.0}"),
            format!("{width:.2}"),
            format!("{beside:.0}"),
            format!("{grows:.2}"),
        ]);
    }
    if update {
        sheet::write("tables/frontier.svg", &svg(&frontier_figure(&draws)))?;
    }
    Ok(text)
}

/// Safety against sharpness: coverage of `replay` at the worst size over the width of its interval, as the share for a
/// cause increases.
fn frontier_figure(draws: &Draws) -> Figure {
    let at = |grows: f64, times: f64| {
        let (held, width) = draws.replay(chance(grows), times);
        (width, held)
    };
    let mut layers = vec![Layer::unnamed(Colour::Grid, Shape::Level(WANTED, Stroke::Dashed))];
    let curves = [1.1, 1.25, TOLD, 2.5, 4.0];
    let colours = [Colour::Blue, Colour::Green, Colour::Ink, Colour::Purple, Colour::Vermilion];
    for (grows, colour) in curves.into_iter().zip(colours) {
        let line = (0..=30).map(|step| at(grows, 0.05 * f64::from(step))).collect();
        layers.push(Layer::new(format!("{grows} times"), colour, Shape::Line(line, Stroke::Solid)));
        let (width, held) = at(grows, 1.0);
        layers.push(Layer::unnamed(colour, Shape::Points(vec![(width, held, 0.0)])));
    }
    Figure {
        name: "frontier",
        title: "Sharpness against safety, by how much the standard error grows".into(),
        caption: format!(
            "One line for each growth of the standard error with the cause beside the law; along it, the interval's part for the cause \
             grows from none to one and a half times that of replay, which is the point. Beyond {TOLD} times replay names the cause instead"
        ),
        panels: vec![Panel {
            x: Axis::log("width without the cause, of the law's own").within(0.97, 6.5),
            y: Axis::new("held at the worst size [%]").within(0.0, 101.0),
            height_px: 320,
            layers,
        }],
    }
}

/// Table and figure for a law that is nearly true.
fn nearly(update: bool) -> Result<String, Error> {
    let (first, seeds) = NEARLY;
    let (sections, figure) = sections(first, seeds)?;
    if update {
        sheet::write("coverage.svg", &svg(&figure))?;
    }
    Ok(format!(
        "
## A law that is nearly true

The first bench with one violation of the law, {seeds} runs of each size, seeds from {first} on; [a figure](../coverage.svg). *size*: the intended shift of the parameter that it moves most, in half widths of that parameter's interval
without the violation; *in U95*: what the size in the next column does move it by. A row is missing where no size does so much, within a third; where the greatest that is sought does less, it is the last. *left*: part of the square of what the violation adds to the force that the law's four regressors leave over, by the plant's truth, as in
[causes](diagnose.md). *told*: runs in which the law is called broken, or a cause is named unasked, or friction is
called presliding or Stribeck's. The others are silent. Of these, each cell gives two percentages: truths that the device's interval holds, and truths that the interval of `replay` holds, which looks at the samples as well
(`uncertainty`, [THEORY](../THEORY.md), 14). An asterisk: the motion does not tell the violation from the parameter, and `replay` says that the parameter rests on its absence (`assumes`).
*error/U95*: root mean square, by `replay`'s interval. A skew as large as it is stated is among the settings that are wrong, above.
{sections}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The factors are the smallest ones with which 90 % are covered at any size, and the limit of the growth is the
    /// largest one at which they are.
    #[test]
    fn the_point_on_the_frontier_is_where_90_percent_are_held() {
        let draws = Draws::new();
        let (held, width) = draws.replay(chance(TOLD), 1.0);
        assert!((WANTED - 0.5..WANTED + 1.0).contains(&held) && width < TOLD, "{held} {width}");
        // A smaller share is not safe, and covering a cause always costs width.
        let (held, _) = draws.replay(chance(TOLD), 0.8);
        assert!(held < WANTED - 3.0, "{held}");
        let (held, width) = draws.replay(chance(4.0), 1.0);
        assert!(held < WANTED - 3.0 && width > 3.0, "{held} {width}");
    }
}
