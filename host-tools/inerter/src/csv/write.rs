//! A run as CSV, from which a replay with the same settings gives the same result to the last digit.

use std::{io::Write, path::Path};

use crate::{
    output::{self, OutputError},
    run::Run,
    series::Converter,
};

/// Writes the run to a file.
pub fn write(run: &Run, path: &Path) -> Result<(), OutputError> {
    let mut out = output::create(path)?;
    write_to(run, &mut out)
        .and_then(|()| out.flush())
        .map_err(|source| OutputError::write(path.display().to_string(), source))
}

/// Writes the run: `t_s, encoder_count, force_n` and, when the run has one, `terminal_m`.
///
/// Encoder counts are sums of `oversampling` counts, as the device latches them, and do not wrap. Numbers are written
/// with the digits that bring back the same counts and codes.
pub fn write_to(run: &Run, out: &mut impl Write) -> std::io::Result<()> {
    let settings = &run.settings;
    let has_terminal = run.samples.iter().any(|sample| sample.terminal_code != 0);
    writeln!(out, "t_s,encoder_count,force_n{}", if has_terminal { ",terminal_m" } else { "" })?;
    let mut converter = Converter::new(settings);
    for sample in &run.samples {
        let point = converter.point(sample);
        let t_s = run.start_s + point.elapsed as f64 / settings.sample_rate_hz;
        write!(out, "{t_s:?},{},{:?}", point.count, point.force_n)?;
        if has_terminal {
            write!(out, ",{:?}", f64::from(sample.terminal_code) * settings.metres_per_terminal_code)?;
        }
        out.write_all(b"\n")?;
    }
    Ok(())
}
