//! `cargo xtask coverage`: width and coverage of the intervals if the law is true, and coverage if it is nearly true.

use inerter_analysis::diagnose::{TOLD, reach};
use inerter_core::{Interval, NORMAL_COVERAGE};
use inerter_data::uncertainty::source_word;
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    backlash,
    coverage::{Bench, RIGHT, STATED, columns},
    grid::{self, Column, MOTIONS, NAMES, RIGS, Result, each, error, motion, sensors},
    nearly::{WANTED, sections},
    sheet::{self, Asked, Measured, significant},
};
use inerter_view::figure::{Axis, Colour, Figure, Layer, Panel, Shape, Stroke, svg};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use std::{
    f64::consts::TAU,
    ops::{Range, RangeInclusive},
};

/// Seeds of the runs that count. Runs 1 to 100 on the first bench determined the share of the encoder's steps.
const SEEDS: Range<u64> = 1001..1401;
/// Seeds of the runs for a law that is nearly true.
const NEARLY: Range<u64> = 2001..2041;
/// Seeds of the runs for tones with a whole number of samples per period.
const TONES: Range<u64> = 4001..4201;
/// Seeds of the runs for the contact.
const CONTACT: Range<u64> = 3001..3061;
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
    let all =
        [first, ("the same, with a clock 10 ppm faster than the shaker's", paper, clock)].into_iter().chain(others);
    all.map(|(name, device, sensors)| Bench { name, device, sensors, wrong: &[] })
}

pub fn measure(asked: Asked) -> Measured {
    let update = asked == Asked::Update;
    let mut text = format!(
        "# Coverage

`cargo xtask coverage --update` writes this table. It shows how wide the interval `U95` over the
whole run is, and how often it contains the true value, if everything that the settings state is
exactly true. Each motion of [accuracy](accuracy.md) has {} runs, with seeds from {} on.

- *rms*: root mean square of the error over `U95`. An exact 95 % interval has 0.51. The goal is {}
  to {}.
- *covered*: percentage of the runs whose interval contains the true value. The goal is 95 % or
  more.
- *broken*: runs in which the law is called broken at the end. The other columns leave them out.
- *rms* and *covered* of a row are bold if either misses its goal by more than chance explains
  (1 in 10 000).
",
        SEEDS.count(),
        SEEDS.start,
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
            let runs = bench.runs(motion, SEEDS)?;
            let broken = runs.iter().filter(|(_, broken)| *broken).count().to_string();
            for (column, name) in columns(&runs).into_iter().zip(NAMES) {
                all += 1;
                right += usize::from(!column.is_wrong());
                blunt += usize::from(column.is_blunt());
                let [u95, rms, covered] = figures(&column, 1.0, 1);
                let [rms, covered] = [rms, covered].map(|text| bold(text, column.is_wrong()));
                text += &sheet::line([motion.name, name, &u95, &rms, &covered, &broken]);
            }
        }
    }
    text += &format!(
        "
{right} of {all} rows are not bold. In {blunt} rows the coverage is above 95 % by more than
chance explains.
"
    );
    text += &tones()?;
    text += &contacts()?;
    text += &stated()?;
    text += &frontier(update)?;
    text += &nearly(update)?;
    Ok((text, true))
}

/// Tones whose period is a whole number of samples, or nearly.
fn tones() -> Result<String> {
    let mut text = format!(
        "
## Tones of a whole number of samples

Each tone has {} runs of the first bench, with seeds from {} on. The amplitudes lie within 15 %
of the one that gives the speed in the table.

- *clock*: with `shared` the shaker runs on the instrument's clock, so each period reads the same
  counts. With `10 ppm` the instrument's clock is faster by this.
- *rms*: of the error over `U95`.
- *%*: percentage of the runs whose interval contains the true value. It is bold where it is below
  95 % by more than chance explains.

| Hz | mm/s | clock | mt: U95 kg | rms | % | cf: U95 N s/m | rms | % | fc: U95 N | rms | % |
|--:|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|
",
        TONES.count(),
        TONES.start
    );
    for hz in [2.0, 5.0, 8.0, 10.0, 12.5] {
        for mm_per_s in [30.0, 80.0] {
            for (clock, ppm) in [("shared", 0.0), ("10 ppm", 10.0)] {
                eprintln!("tone: {hz} Hz, {mm_per_s} mm/s, {clock}");
                let sample_rate_hz = sensors().sample_rate_hz * (1.0 + 1e-6 * ppm);
                let sensors = Sensors { sample_rate_hz, ..sensors() };
                let bench = Bench { name: "tones", device: Inerter::paper(), sensors, wrong: &[] };
                let runs = each(TONES, |seed| {
                    let number = seed - TONES.start + 1;
                    let part = 0.85 + 0.3 * ((number as f64 * 0.7549) % 1.0);
                    let motion = format!("sine:{hz}Hz:{}mm", part * mm_per_s / (TAU * hz));
                    bench.run(&motion, 20.0, seed)
                })?;
                let figures = columns(&runs).into_iter().flat_map(|column| bold_figures(&column, 0));
                text += &sheet::row(&[&hz.to_string(), &mm_per_s.to_string(), clock], figures);
            }
        }
    }
    Ok(text)
}

/// Backlash, stiffness and damping of the contact, on a rig with true settings.
fn contacts() -> Result<String> {
    let mut text = format!(
        "
## Contact

Backlash by the force alone, with the stiffness known to 0.1 %, and by the terminal's sensor, which
also gives stiffness and damping. Each cell has {} runs, with seeds from {} on. Everything else
that the settings state is exactly true. U95 is in um for a backlash, and in per cent otherwise.
Runs without a value are not counted.
",
        CONTACT.count(),
        CONTACT.start
    );
    let mut all: Vec<Column> = Vec::new();
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
                let runs = each(CONTACT, shaken)?;
                let mut of = |read: fn(&backlash::Run) -> Option<Interval>, truth: f64, unit: f64| {
                    let column = Column::of(runs.iter().filter_map(read).map(|found| error(found, truth)));
                    if column.given == 0 {
                        return ["-"; 3].map(String::from);
                    }
                    all.push(column);
                    figures(&column, unit, 1)
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
    let count = |which: &dyn Fn(&Column) -> bool| all.iter().filter(|column| which(column)).count();
    text += &format!(
        "
In each of {} cells the coverage is at least {:.1} %. The rms is over {} in {} of them, and under
{} in {}.
",
        all.len(),
        all.iter().map(covered_percent).fold(f64::INFINITY, f64::min),
        RIGHT.end(),
        count(&|column| column.rms > *RIGHT.end()),
        RIGHT.start(),
        count(&|column| column.rms < *RIGHT.start()),
    );
    Ok(text)
}

/// Settings that are wrong by their stated uncertainty.
fn stated() -> Result<String> {
    let chance = 196.0 * (0.95 * 0.05 / SEEDS.count() as f64).sqrt();
    let mut text = format!(
        "
## Settings that are wrong by their stated uncertainty

A Monte Carlo simulation after JCGM 101. In each of {} runs of the first bench, settings have
normal errors of the size that they state: one source at a time, then all of them. The stated half
widths (95 %) are 0.5 % of the force's gain, 0.2 % of the lead, 0.1 % of the timebase, 20 us of
skew, 0.1 kg of the structure's 1.5, and 20 % of the contact's stiffness. With so many runs, the
coverage of an exact interval lies between {:.1} and {:.1} % by chance.

| wrong | motion | broken | mt: U95 | rms | covered % | cf: U95 | rms | covered % | fc: U95 | rms | covered % |
|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|
",
        SEEDS.count(),
        95.0 - chance,
        95.0 + chance
    );
    let (mut by_one, mut by_all) = (Vec::new(), Vec::new());
    let alone = STATED.iter().map(|source| (source_word(*source), std::slice::from_ref(source)));
    for (name, wrong) in alone.chain([("all", &STATED[..])]) {
        let bench = Bench { name, device: Inerter::paper(), sensors: sensors(), wrong };
        for motion in ["fast", "random", "two"].map(motion) {
            eprintln!("{name}: {}", motion.name);
            let runs = bench.runs(motion, SEEDS)?;
            let found = columns(&runs);
            let covered = if wrong.len() == 1 { &mut by_one } else { &mut by_all };
            covered.extend(found.iter().filter(|column| column.given > 0).map(covered_percent));
            let broken = runs.iter().filter(|(_, broken)| *broken).count().to_string();
            let figures = found.iter().flat_map(|column| bold_figures(column, 1));
            text += &sheet::row(&[name, motion.name, &broken], figures);
        }
    }
    for (wrong, mut covered) in [("With one source wrong", by_one), ("With all sources wrong", by_all)] {
        covered.sort_by(f64::total_cmp);
        let under = covered.partition_point(|one| one < HELD.start());
        let over = covered.len() - covered.partition_point(|one| one <= HELD.end());
        text += &format!(
            "
{wrong}, {} of {} cells have a coverage of {} to {} %, {under} have less and {over} have more.
The range is {:.1} to {:.1} %.
",
            covered.len() - under - over,
            covered.len(),
            HELD.start(),
            HELD.end(),
            covered[0],
            covered[covered.len() - 1],
        );
    }
    Ok(text)
}

/// Half width in units of this many per unit, rms, and covered runs with this number of decimals \[%\].
fn figures(column: &Column, unit: f64, decimals: usize) -> [String; 3] {
    let covered = format!("{:.decimals$}", covered_percent(column));
    [significant(column.u95 * unit), format!("{:.2}", column.rms), covered]
}

/// The same, bold where too few are covered.
fn bold_figures(column: &Column, decimals: usize) -> [String; 3] {
    let [u95, rms, covered] = figures(column, 1.0, decimals);
    [u95, rms, bold(covered, column.is_low())]
}

fn bold(text: String, is_bold: bool) -> String {
    if is_bold { format!("**{text}**") } else { text }
}

fn covered_percent(column: &Column) -> f64 {
    100.0 * column.covered() as f64 / column.given as f64
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
fn frontier(update: bool) -> Result<String> {
    let draws = Draws::new();
    let mut text = format!(
        "
## Frontier

A cause that the law does not model can move a parameter by any amount. The run estimates that
amount with a random error. This simulation has normal errors, {DRAWN} draws for each size of the
cause. [A figure](frontier.svg) shows the result.

- *growth*: factor by which the standard error grows if the cause is fitted together with the law.
- *law alone*: the interval of the law without the cause. *replay*: the interval of `replay`.
  *law with cause*: the interval of both fitted together, which is unbiased.
- *covered*: the lowest coverage over all sizes of the cause.
- *width*: mean width if there is no such cause, relative to that of the law alone.

| growth | law alone: covered % | replay: covered % | width | law with cause: covered % | width |
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
        title: "Coverage over width, by the growth of the standard error".into(),
        caption: format!(
            "Each line is for one growth of the standard error if the cause is fitted together with the law. Along it, the share \
             of the interval for the cause grows from zero to one and a half times that of replay. The point marks the share of \
             replay. If the growth exceeds {TOLD}, replay lists the assumption instead"
        ),
        panels: vec![Panel {
            x: Axis::log("width without the cause, relative to the law alone").within(0.97, 6.5),
            y: Axis::new("coverage at the worst size [%]").within(0.0, 101.0),
            height_px: 320,
            layers,
        }],
    }
}

/// Table and figure for a law that is nearly true.
fn nearly(update: bool) -> Result<String> {
    let (sections, figure) = sections(NEARLY)?;
    if update {
        sheet::write("coverage.svg", &svg(&figure))?;
    }
    Ok(format!(
        "
## A law that is nearly true

The first bench with one violation of the law. Each size has {} runs, with seeds from {} on.
[A figure](../coverage.svg) shows the coverage.

- *intended*: the intended shift of the parameter that the violation moves most, in half widths of
  that parameter's interval without the violation. *in U95*: the shift that the size in the next
  column causes. A row is left out if no size causes the intended shift to within a third. If even
  the largest size searched causes less, that size is the last row.
- *left*: the fraction of the mean square of the force added by the violation that the law's four
  regressors cannot explain, from the plant's true values, as in [causes](diagnose.md).
- *reported*: runs in which the law is called broken, a cause is named without being asked for, or
  friction is called presliding or Stribeck. The other runs are silent.
- *covered*: coverage in the silent runs, first of the device's interval, then of the interval of
  `replay`, which also uses the samples (`uncertainty`, [THEORY](../THEORY.md), 14). An asterisk: in
  most silent runs `replay` reports that the parameter assumes the absence of the violation
  (`assumes`), because the motion cannot distinguish the two.
- *error/U95*: root mean square for mt, cf and fc, with the interval of `replay`.

A skew that is wrong by its stated uncertainty is among the wrong settings above.
{sections}",
        NEARLY.count(),
        NEARLY.start
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
