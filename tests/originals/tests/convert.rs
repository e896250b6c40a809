//! Small originals in the published formats, through the program's whole way. `emps.mat` was written by scipy 1.17,
//! compressed.

use std::{fs, path::PathBuf};

/// A folder of its own, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("inerter-originals-{}-{name}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        fs::write(&path, text).unwrap();
        path
    }

    fn convert(&self, files: &[PathBuf]) -> Result<Vec<String>, String> {
        let written = inerter_originals::convert(files, &self.0).map_err(|error| error.to_string())?;
        Ok(written.iter().map(|path| path.strip_prefix(&self.0).unwrap().display().to_string()).collect())
    }

    fn lines(&self, name: &str) -> Vec<String> {
        fs::read_to_string(self.0.join(name)).unwrap().lines().map(str::to_owned).collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn emps_by_its_gain_and_counts_of_50_nm() {
    let folder = Folder::new("emps");
    let mat = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/emps.mat");
    let original = folder.0.join("DATA_EMPS.mat");
    fs::copy(mat, &original).unwrap();
    assert_eq!(folder.convert(&[original]).unwrap(), ["emps/emps.csv"]);
    let lines = folder.lines("emps/emps.csv");
    assert_eq!(lines.len(), 21);
    assert_eq!(lines[..2], ["t_s,encoder_count,force_n", "0.000000,149,17.575326"]);
    assert_eq!([&lines[8], &lines[15]], ["0.007000,2940,15.114780", "0.014000,5676,12.654235"]);
}

#[test]
fn arts_in_micrometres_and_newtons() {
    let folder = Folder::new("arts");
    let rows = "[[0.0, 0.0005362, -0.0655, -0.007, 25.1, 13.3], [0.0009765625, -1.5, 0.5, 0.0, 1.0, 2.0]]";
    let original = folder.file("1Hz20lbtension.json", &format!("{{\"data\": {rows}}}"));
    assert_eq!(folder.convert(&[original]).unwrap(), ["arts/1hz_20lb.csv"]);
    let lines = folder.lines("arts/1hz_20lb.csv");
    assert_eq!(lines[1..], ["0.000000,14,-291.358410", "0.000977,-38100,2224.110000"]);
    let bad = folder.file("0.5Hz35lbtension.json", "{\"data\": [[0.0, 1.0]]}");
    let error = folder.convert(&[bad]).unwrap_err();
    assert!(error.ends_with("0.5Hz35lbtension.json: row 0: no number in column 2"), "{error}");
}

/// Half a turn of a sine in speed: the motor from rest to rest, -1 m in all at 1 s and 20 mm a turn, from 0.2 s on.
fn speed_rpm(t_s: f64) -> f64 {
    let phase = (t_s - 0.2) / 0.8;
    if (0.0..1.0).contains(&phase) { -60.0 * (std::f64::consts::PI * phase).sin() } else { 0.0 }
}

/// What the motor has moved by then \[m\].
fn position_m(t_s: f64) -> f64 {
    let phase = ((t_s - 0.2) / 0.8).clamp(0.0, 1.0);
    0.020 * 0.8 / std::f64::consts::PI * (1.0 - (std::f64::consts::PI * phase).cos())
}

/// The card's clock shows so much more \[s\].
const LATER_S: f64 = 0.0725;

fn logs(folder: &Folder) -> [PathBuf; 2] {
    let mut servo = String::from(
        "Axis1\nNumber of sampling data,1500\nSampling time interval(ms),0.889\nTime,Analog 1,Analog 2,Analog 3\n\
         ms,Servo motor speed,Torque,Not selected\n",
    );
    for n in 0..1500 {
        let t_ms = f64::from(n) * 0.888_888;
        servo += &format!("{t_ms:.6},{:.6},3.300000,0\n", speed_rpm(t_ms / 1000.0));
    }
    let mut card = String::from(
        "Timestamp,24.07.2020 12:38:13,Timestamp,24.07.2020 12:38:13\nInterval,0.0005,Interval,0.0005\n\
         Channel name,\"F\",Channel name,\"x\"\nUnit,\"V\",Unit,\"V\"\n",
    );
    for n in 0..2600 {
        let t_s = f64::from(n) * 0.0005;
        let potentiometer_v = 55.4 * position_m(t_s - LATER_S) - 1.972;
        card += &format!("{t_s},{},{t_s},{potentiometer_v}\n", 0.1 + 0.0001 * f64::from(n));
    }
    [folder.file("24072020-sym_r0_mr.csv", &servo), folder.file("24072020-sym_r0_ni.csv", &card)]
}

#[test]
fn lodz_with_both_clocks_aligned_on_the_potentiometer() {
    let folder = Folder::new("lodz");
    assert_eq!(folder.convert(&logs(&folder)).unwrap(), ["lodz/sym_r0.csv"]);
    let lines = folder.lines("lodz/sym_r0.csv");
    let rows: Vec<[f64; 3]> = lines[1..]
        .iter()
        .map(|line| {
            let mut cells = line.split(',').map(|cell| cell.parse().unwrap());
            std::array::from_fn(|_| cells.next().unwrap())
        })
        .collect();
    // The servo's first sample stands between two of the card's.
    let first = (-(rows[0][2] / 200.0 + 0.1) / 0.0001).round();
    assert!((144.0..=146.0).contains(&first), "it begins with the card's sample {first}");
    for [t_s, count, force_n] in &rows {
        let n = first + (t_s / 0.0005).round();
        assert!((force_n + 200.0 * (0.1 + 0.0001 * n)).abs() < 1e-6, "{t_s} s: {force_n} N");
        let truth = position_m(n * 0.0005 - LATER_S) * 1e6;
        assert!((count - truth).abs() < 2.0, "{t_s} s: {count} counts for {truth}");
    }
    assert!(rows.len() > 2400 && rows.iter().any(|row| row[1] > 10_000.0));
}

#[test]
fn half_of_a_pair_and_strangers_are_refused_by_name() {
    let folder = Folder::new("refused");
    let [servo, card] = logs(&folder);
    assert!(folder.convert(std::slice::from_ref(&servo)).unwrap_err().contains("24072020-sym_r0_ni.csv"));
    assert!(folder.convert(&[folder.file("what.txt", "")]).unwrap_err().contains("what.txt"));
    // Potentiometer of another run: it stands still.
    let still: String =
        fs::read_to_string(&card).unwrap().lines().enumerate().fold(String::new(), |text, (place, line)| {
            let line = if place < 4 { line.to_owned() } else { format!("{},-1.9", line.rsplit_once(',').unwrap().0) };
            text + &line + "\n"
        });
    fs::write(&card, still).unwrap();
    let error = folder.convert(&[servo, card]).unwrap_err();
    assert!(error.contains("sym_r0: ") && error.contains("the same motion"), "{error}");
}
