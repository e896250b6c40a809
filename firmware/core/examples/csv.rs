//! Prints the estimates of a recording: `cargo run -p inerter-core --example csv -- FILE.csv [METRES_PER_COUNT]`.
//!
//! The file has the columns `t_s, encoder_count, force_n` and a line of names. Missing rows are recognised by their
//! time.

use inerter_core::{Output, Parameter, Published, RawSample, Settings, State};
use std::error::Error;

/// Force per code [N]: fine compared with any load cell's noise.
const NEWTONS_PER_CODE: f64 = 1e-3;

struct Row {
    t_s: f64,
    encoder_count: f64,
    force_n: f64,
}

fn parse(line: &str) -> Option<Row> {
    let mut cells = line.split(',').map(|cell| cell.trim().parse().ok());
    Some(Row { t_s: cells.next()??, encoder_count: cells.next()??, force_n: cells.next()?? })
}

fn read(path: &str) -> Result<Vec<Row>, Box<dyn Error>> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("cannot read {path}: {error}"))?;
    let lines = text.lines().enumerate().skip(1).filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(number, line)| parse(line).ok_or_else(|| format!("{path}:{}: not three numbers", number + 1).into()))
        .collect()
}

fn text(parameter: &Parameter) -> String {
    match parameter {
        Parameter::Ok(known) => format!("{:.3} +- {:.3}", known.value, known.u95),
        Parameter::Held(known) => format!("{:.3} +- {:.3} (held)", known.value, known.u95),
        Parameter::NotIdentifiable(_) => "-".into(),
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("name a CSV with the columns t_s, encoder_count, force_n")?;
    let rows = read(&path)?;
    let mut periods: Vec<f64> = rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect();
    periods.sort_by(f64::total_cmp);
    let period_s = *periods.get(periods.len() / 2).ok_or("fewer than two rows")?;
    let mut settings =
        Settings { sample_rate_hz: 1.0 / period_s, newtons_per_code: NEWTONS_PER_CODE, ..Settings::default() };
    if let Some(metres) = arguments.next() {
        settings.metres_per_count = metres.parse()?;
    }
    let active = settings.validate()?;
    let mut state = Box::new(State::new(&active));
    println!("t [s]; inertance [kg]; viscous [N s/m]; Coulomb [N]; offset [N]");
    for row in &rows {
        let sample = RawSample {
            index: ((row.t_s - rows[0].t_s) / period_s).round() as u32,
            position_count: row.encoder_count as i64 as i32,
            force_code: (row.force_n / NEWTONS_PER_CODE).round() as i32,
            terminal_code: 0,
        };
        let Output { published, change, .. } = active.step(&mut state, &sample);
        if let Some(Published { estimate, .. }) = published {
            let recent = &estimate.recent;
            let parameters = [recent.inertance_kg, recent.viscous_n_s_per_m, recent.coulomb_n, recent.offset_n];
            println!("{:.2}; {}", row.t_s, parameters.each_ref().map(text).join("; "));
        }
        if let Some(change) = change {
            println!(
                "{:.2}; the device has changed: {:?} from {} to {}",
                row.t_s, change.parameter, change.before, change.after
            );
        }
    }
    let whole = active.publish(&state).estimate.whole_run;
    println!(
        "whole run: {} kg, {} N s/m, {} N",
        text(&whole.inertance_kg),
        text(&whole.viscous_n_s_per_m),
        text(&whole.coulomb_n)
    );
    Ok(())
}
