//! Lodz: the servo's log and that of the measuring card, each on a clock of its own, started by hand.
//!
//! - *Servo* (`.._mr.csv`, Mitsubishi's MR Configurator): five lines of heading, then time \[ms\], motor speed \[rpm\],
//!   and more.
//! - *Card* (`.._ni.csv`, National Instruments' DAQExpress): timestamp, interval \[s\], names `F` and `x` and units of
//!   the channels, then time, force \[V\], time, potentiometer \[V\].
//!
//! Position is the integral of the servo's speed. The potentiometer shows the same motion on the card's clock,
//! coarsely: the servo's clock is moved until both agree best. Time starts with the first sample of the card that both
//! have.

use crate::samples::{Error, Row};

/// Travel per turn of the motor, whose positive turn pulls \[m\].
const TRAVEL_M: f64 = -0.020;
/// The load cell's amplifier, pulling negative \[N/V\].
const FORCE_N_PER_V: f64 = -200.0;
/// The potentiometer \[V/m\].
const POTENTIOMETER_V_PER_M: f64 = 55.4;
/// Position of one encoder count \[m\].
const COUNT_M: f64 = 1e-6;
/// Finest step in which the servo's clock is moved \[s\].
const FINEST_S: f64 = 10e-6;

/// Values at equal intervals, the first at time zero of their clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    interval_s: f64,
    values: Vec<f64>,
}

impl Series {
    /// The value at a time, between two samples on the line that joins them; beyond the ends it stays.
    fn at(&self, t_s: f64) -> f64 {
        let last = self.values.len() - 1;
        let place = (t_s / self.interval_s).clamp(0.0, last as f64);
        let (before, part) = (place.floor() as usize, place.fract());
        self.values[before] + part * (self.values[(before + 1).min(last)] - self.values[before])
    }

    /// Time of the last value \[s\].
    fn end_s(&self) -> f64 {
        (self.values.len() - 1) as f64 * self.interval_s
    }
}

/// What the card recorded: force \[N\], potentiometer \[m\].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Card {
    force_n: Vec<f64>,
    position: Series,
}

/// Numbers of one line, which begins with as many as are wanted.
fn numbers<const N: usize>(line: &str) -> Result<[f64; N], Error> {
    let mut cells = line.split(',');
    let mut row = [0.0; N];
    for number in &mut row {
        *number = cells.next().and_then(|cell| cell.trim().parse().ok()).ok_or(format!("not {N} numbers: `{line}`"))?;
    }
    Ok(row)
}

/// Heading and rows of a log; bytes that are no UTF-8, as of an `um`, stand in headings only.
fn rows<const N: usize>(bytes: &[u8], heading: usize) -> Result<(Vec<String>, Vec<[f64; N]>), Error> {
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    let head = lines.by_ref().take(heading).map(str::to_owned).collect();
    let rows = lines.map(numbers).collect::<Result<Vec<_>, _>>()?;
    if rows.len() < 2 {
        return Err("no samples".into());
    }
    Ok((head, rows))
}

/// Position by the servo's log \[m\].
pub fn servo(bytes: &[u8]) -> Result<Series, Error> {
    let (head, rows) = rows::<2>(bytes, 5)?;
    if !head.last().is_some_and(|units| units.starts_with("ms,Servo motor speed")) {
        return Err("the fifth line does not say `ms,Servo motor speed`".into());
    }
    let interval_s = (rows[1][0] - rows[0][0]) / 1000.0;
    let speeds: Vec<f64> = rows.iter().map(|[_, rpm]| rpm / 60.0 * TRAVEL_M).collect();
    let mut values = vec![0.0];
    for pair in speeds.windows(2) {
        values.push(values[values.len() - 1] + (pair[0] + pair[1]) / 2.0 * interval_s);
    }
    Ok(Series { interval_s, values })
}

/// Force and potentiometer by the card's log.
pub fn card(bytes: &[u8]) -> Result<Card, Error> {
    let (head, rows) = rows::<4>(bytes, 4)?;
    let plain = |place: usize| head.get(place).map(|line| line.replace('"', "")).unwrap_or_default();
    if plain(2) != "Channel name,F,Channel name,x" || plain(3) != "Unit,V,Unit,V" {
        return Err("the heading does not name the channels F and x in volts".into());
    }
    let interval_s = rows[1][0] - rows[0][0];
    let values = rows.iter().map(|[.., volts]| volts / POTENTIOMETER_V_PER_M).collect();
    let force_n = rows.iter().map(|[_, volts, ..]| volts * FORCE_N_PER_V).collect();
    Ok(Card { force_n, position: Series { interval_s, values } })
}

/// How far the positions are from each other while the card's clock shows so much more than the servo's: the variance,
/// as both zeros are free \[m^2\].
fn misfit(servo: &Series, potentiometer: &Series, later_s: f64) -> f64 {
    let count = potentiometer.values.len() as f64;
    let (mut sum, mut squares) = (0.0, 0.0);
    for (place, position) in potentiometer.values.iter().enumerate() {
        let off = position - servo.at(place as f64 * potentiometer.interval_s - later_s);
        sum += off;
        squares += off * off;
    }
    (squares - sum * sum / count) / count
}

/// How much more the card's clock shows than the servo's \[s\]: with that the positions agree best.
fn later_s(servo: &Series, potentiometer: &Series) -> f64 {
    let best = |from: f64, to: f64, step: f64| {
        let steps = ((to - from) / step).round() as i64;
        let moves = (0..=steps).map(|n| from + n as f64 * step);
        let misfits = moves.map(|later_s| (misfit(servo, potentiometer, later_s), later_s));
        misfits.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, later_s)| later_s)
    };
    let mut step = 10.0 * potentiometer.interval_s;
    let mut found = best(-servo.end_s(), potentiometer.end_s(), step);
    while step > FINEST_S {
        let finer = (step / 10.0).max(FINEST_S);
        found = best(found - step, found + step, finer);
        step = finer;
    }
    found
}

/// Both on one clock.
pub fn join(servo: &Series, card: &Card) -> Result<Vec<Row>, Error> {
    let later_s = later_s(servo, &card.position);
    let interval_s = card.position.interval_s;
    let first = (later_s / interval_s).ceil().max(0.0) as usize;
    let both = card.force_n.iter().enumerate().skip(first);
    let both = both.take_while(|(place, _)| *place as f64 * interval_s - later_s <= servo.end_s());
    let rows: Vec<_> = both
        .map(|(place, force_n)| {
            let count = (servo.at(place as f64 * interval_s - later_s) / COUNT_M).round() as i64;
            ((place - first) as f64 * interval_s, count, *force_n)
        })
        .collect();
    if rows.len() < card.force_n.len() / 2 {
        return Err("servo and potentiometer do not show the same motion".into());
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One stroke there and half of it back, from 0.3 s on \[m\].
    fn stroke(t_s: f64) -> f64 {
        let phase = ((t_s - 0.3) / 1.2).clamp(0.0, 1.0);
        0.1 * (std::f64::consts::PI * 1.5 * phase).sin().powi(2)
    }

    #[test]
    fn the_clocks_difference_is_found_to_a_tenth_of_a_millisecond() {
        let servo = Series {
            interval_s: 0.000_888_888,
            values: (0..2500).map(|n| stroke(f64::from(n) * 0.000_888_888)).collect(),
        };
        for later_s in [0.0723, -0.0512, 0.3] {
            // The potentiometer has steps of 6 um and some noise, and a zero of its own.
            let noisy = |n: u32| {
                let exact = stroke(f64::from(n) * 0.0005 - later_s) - 0.0357 + 2e-5 * f64::from(n * 7919 % 13) / 13.0;
                (exact / 6e-6).round() * 6e-6
            };
            let potentiometer = Series { interval_s: 0.0005, values: (0..3600).map(noisy).collect() };
            let found = super::later_s(&servo, &potentiometer);
            assert!((found - later_s).abs() < 1e-4, "{found} for {later_s}");
        }
    }

    #[test]
    fn a_log_of_something_else_is_refused() {
        assert!(servo(b"a\nb\nc\nd\nms,Torque\n0,1\n1,2\n").is_err());
        assert!(
            card(b"a\nb\nChannel name,\"x\",Channel name,\"F\"\nUnit,\"V\",Unit,\"V\"\n0,1,0,1\n1,1,1,1\n").is_err()
        );
        assert!(servo(b"a\nb\nc\nd\nms,Servo motor speed\n0,1\n").unwrap_err().to_string().contains("no samples"));
    }
}
