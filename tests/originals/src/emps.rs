//! EMPS: `DATA_EMPS.mat`, a MATLAB file (level 5) with the vectors `t` \[s\], `qm`, the position \[m\], and `vir`, the
//! control signal \[V\], and the number `gtau`, the drive's gain \[N/V\].

use crate::samples::{Error, Row};
use matfile::{MatFile, NumericData};

/// Position of one encoder count \[m\].
const COUNT_M: f64 = 50e-9;

/// Position in counts; force is gain times control signal.
pub fn samples(bytes: &[u8]) -> Result<Vec<Row>, Error> {
    let file = MatFile::parse(bytes)?;
    let vector = |name: &str| match file.find_by_name(name).map(matfile::Array::data) {
        Some(NumericData::Double { real, imag: None }) => Ok(real.as_slice()),
        Some(_) => Err(format!("`{name}` holds no real numbers")),
        None => Err(format!("no `{name}`")),
    };
    let (t_s, position_m, signal_v) = (vector("t")?, vector("qm")?, vector("vir")?);
    let &[gain_n_per_v] = vector("gtau")? else { return Err("`gtau` is no single number".into()) };
    if t_s.len() != position_m.len() || t_s.len() != signal_v.len() {
        return Err(format!("{} times, {} positions, {} signals", t_s.len(), position_m.len(), signal_v.len()).into());
    }
    let rows = t_s.iter().zip(position_m).zip(signal_v);
    Ok(rows.map(|((t_s, m), v)| (*t_s, (m / COUNT_M).round() as i64, gain_n_per_v * v)).collect())
}
