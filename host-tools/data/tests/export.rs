//! Exported files read back by other libraries.

use std::{
    collections::BTreeMap,
    fs,
    ops::Range,
    path::{Path, PathBuf},
};

use hdf5_pure::AttrValue;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors, file::write_recording};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use serde_json::Value;
use tempfile::TempDir;

use inerter_core::Machine;
use inerter_data::{
    Error,
    export::{Column, EstimateTable, Exported, Format, Selection, Source, export, write_csv},
    open,
    recording::RecordingError,
    settings::Overrides,
};

fn read_csv(path: &Path) -> (Vec<String>, Vec<Vec<f64>>) {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let names = reader.headers().unwrap().iter().map(String::from).collect();
    let number = |cell: &str| if cell.is_empty() { f64::NAN } else { cell.parse().unwrap() };
    let rows = reader.records().map(|row| row.unwrap().iter().map(number).collect()).collect();
    (names, rows)
}

fn read_parquet(path: &Path) -> (Vec<String>, Vec<Vec<f64>>, BTreeMap<String, Value>) {
    let reader = SerializedFileReader::new(fs::File::open(path).unwrap()).unwrap();
    let about = reader.metadata().file_metadata().clone();
    let names = about.schema().get_fields().iter().map(|field| field.name().to_string()).collect();
    let entries = about.key_value_metadata().unwrap().iter();
    let entry = |entry: &parquet::file::metadata::KeyValue| {
        (entry.key.clone(), serde_json::from_str(entry.value.as_ref().unwrap()).unwrap())
    };
    let number = |field: &Field| match field {
        Field::Double(value) => *value,
        Field::Long(value) => *value as f64,
        Field::Bool(flag) => f64::from(u8::from(*flag)),
        Field::Null => f64::NAN,
        other => panic!("{other:?}"),
    };
    let row = |row: parquet::record::Row| row.get_column_iter().map(|(_, field)| number(field)).collect();
    let rows = reader.get_row_iter(None).unwrap().map(|found| row(found.unwrap())).collect();
    (names, rows, entries.map(entry).collect())
}

/// Five seconds of a simulated device, with a marker, in a folder of their own.
fn recorded(terminal: bool) -> (TempDir, PathBuf, Source) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let overrides = Overrides::from_inputs(None, &[format!("terminal_sensor={}", u8::from(terminal))]).unwrap();
    let setup =
        Setup::new(Inerter::paper(), Sensors { seed: 3, ..bench_sensors() }, "random", Some(5.0), &overrides).unwrap();
    write_recording(&setup, &path, false, |_| Ok(())).unwrap();
    let source = source(&path);
    (folder, path, source)
}

fn source(path: &Path) -> Source {
    Source::open(path, &Overrides::default(), |_| ()).unwrap()
}

fn all_of(source: &Source, selection: &Selection, folder: &Path) -> Exported {
    let formats = [Format::Csv, Format::Parquet, Format::Mat, Format::Mcap];
    let targets: Vec<(Format, PathBuf)> =
        formats.into_iter().zip(["o.csv", "o.parquet", "o.mat", "o.mcap"].map(|name| folder.join(name))).collect();
    let table = EstimateTable::collect(source, &selection.range_s).unwrap();
    export(source, selection, &targets, false, Some(&table), &mut |_| Ok(())).unwrap()
}

/// The expected content of all files.
fn expected(path: &Path, columns: &[Column], range_s: Range<f64>) -> Vec<Vec<f64>> {
    let run = open(path, &Overrides::default()).unwrap();
    let source = source(path);
    let mut converter = inerter_data::series::Converter::new(&run.settings);
    let rows = run.samples.iter().map(|sample| (sample, converter.point(sample)));
    rows.filter(|(_, point)| range_s.contains(&(point.elapsed as f64 * 1e-3)))
        .map(|(sample, point)| columns.iter().map(|column| column.value(&source, sample, &point)).collect())
        .collect()
}

#[test]
fn every_format_holds_the_same_numbers() {
    let (folder, path, source) = recorded(true);
    let columns = Column::ALL.to_vec();
    let selection = Selection { columns: Some(columns.clone()), range_s: 1.0..2.25 };
    let exported = all_of(&source, &selection, folder.path());
    assert_eq!(exported.rows, 1250);
    let expected = expected(&path, &columns, 1.0..2.25);
    assert_eq!(expected.len(), 1250);
    let names: Vec<String> = columns.iter().map(|column| column.name(Machine::Linear).to_string()).collect();
    assert_eq!(read_csv(&folder.path().join("o.csv")), (names.clone(), expected.clone()));
    let (found, rows, about) = read_parquet(&folder.path().join("o.parquet"));
    assert_eq!((found, rows), (names, expected.clone()));
    assert_eq!(about["inerter.units"]["force_n"], "N");
    assert_eq!(about["inerter.units"].get("index"), None);
    assert_eq!(about["inerter.settings"]["sample_rate_hz"], 1000.0);
    assert_eq!(about["PANDAS_ATTRS"]["settings"], about["inerter.settings"]);
    assert_eq!(about["inerter.device"]["board"], "simulated");
    let mat = hdf5_pure::File::open(folder.path().join("o.mat")).unwrap();
    for (number, column) in columns.iter().enumerate() {
        let data = mat.dataset(column.name(Machine::Linear)).unwrap();
        assert_eq!(
            data.shape().unwrap(),
            [1, 1250],
            "a column vector for MATLAB, whose dimensions are stored the other way"
        );
        let values: Vec<f64> = expected.iter().filter_map(|row| row.get(number)).copied().collect();
        assert_eq!(data.read_f64().unwrap(), values, "{}", column.name(Machine::Linear));
        assert!(
            matches!(data.attrs().unwrap().get("MATLAB_class"), Some(AttrValue::AsciiString(class)) if class == "double")
        );
    }
    assert!(fs::read(folder.path().join("o.mat")).unwrap().starts_with(b"MATLAB 7.3 MAT-file"));
    assert_eq!(mat.dataset("settings/sample_rate_hz").unwrap().read_f64().unwrap(), [1000.0]);
    let bytes = fs::read(folder.path().join("o.mcap")).unwrap();
    let lines: Vec<(u64, Value)> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap())
        .map(|message| (message.log_time, serde_json::from_slice(&message.data).unwrap()))
        .collect();
    assert_eq!(lines.len(), 1250);
    for ((time_ns, line), row) in lines.iter().zip(&expected) {
        assert_eq!(*time_ns, source.first_ns + (row[0] * 1e9).round() as u64);
        for (column, value) in columns.iter().zip(row) {
            // Only as exact as this JSON reader.
            let found = line[column.name(Machine::Linear)].as_f64().unwrap();
            assert!((found - value).abs() <= 1e-15 * value.abs(), "{found} {value}");
        }
    }
}

#[test]
fn estimates_are_those_that_the_device_published() {
    let (folder, path, source) = recorded(true);
    let exported = all_of(&source, &Selection::default(), folder.path());
    assert_eq!((exported.rows, exported.estimates, exported.files.len()), (5000, 26, 6));
    let (names, rows) = read_csv(&folder.path().join("o.estimates.csv"));
    let (same_names, same_rows, about) = read_parquet(&folder.path().join("o.estimates.parquet"));
    let bits = |rows: &[Vec<f64>]| -> Vec<Vec<u64>> {
        rows.iter().map(|row| row.iter().map(|value| value.to_bits()).collect()).collect()
    };
    assert_eq!((&names, bits(&rows)), (&same_names, bits(&same_rows)));
    assert_eq!(about["inerter.units"]["viscous_u95_n_s_per_m"], "N s/m");
    let mat = hdf5_pure::File::open(folder.path().join("o.mat")).unwrap();
    let run = open(&path, &Overrides::default()).unwrap();
    let outcome = inerter_data::replay::replay(&run, |_, _| Ok::<(), Error>(())).unwrap();
    let inertance = outcome.estimate.recent.inertance_kg;
    let stiffness = outcome.detail.stiffness_n_per_m;
    for (name, value) in [
        ("t_s", 4.999),
        ("inertance_kg", inertance.fitted().value.into()),
        ("inertance_u95_kg", inertance.u95().into()),
        ("whole_run_coulomb_n", outcome.estimate.whole_run.coulomb_n.fitted().value.into()),
        ("contact_damping_u95_n_s_per_m", outcome.detail.contact_damping_n_s_per_m.u95().into()),
        ("stiffness_n_per_m", stiffness.fitted().value.into()),
    ] {
        let place = names.iter().position(|known| known == name).unwrap_or_else(|| panic!("no column {name}"));
        assert_eq!(rows.last().unwrap()[place], value, "{name}");
        let column = mat.dataset(&format!("estimates/{name}")).unwrap().read_f64().unwrap();
        assert_eq!((column.len(), *column.last().unwrap()), (26, value), "{name}");
    }
    assert!(rows[0][names.iter().position(|name| name == "inertance_kg").unwrap()].is_nan(), "nothing is known yet");
}

#[test]
fn a_csv_gives_the_estimates_that_its_recording_has() {
    let (folder, _, recording) = recorded(false);
    let csv = folder.path().join("run.csv");
    let targets = [(Format::Csv, csv.clone())];
    export(&recording, &Selection::default(), &targets, true, None, &mut |_| Ok(())).unwrap();
    let toml = inerter_data::settings::write_beside(&recording.settings, None, &csv, false).unwrap();
    let again = Source::open(&csv, &Overrides::from_inputs(Some(&toml), &[]).unwrap(), |_| ()).unwrap();
    let range_s = 0.0..f64::INFINITY;
    let (mut device, replayed) =
        (EstimateTable::collect(&recording, &range_s).unwrap(), EstimateTable::collect(&again, &range_s).unwrap());
    // The device's last value came after the motion; a replay returns it with its outcome.
    for column in &mut device.columns {
        column.values.pop();
    }
    for (column, replayed) in device.columns.iter().zip(&replayed.columns) {
        assert_eq!(column, replayed);
    }
}

#[test]
fn what_is_broken_off_or_empty_leaves_the_file_that_was_there() {
    let (folder, _, source) = recorded(false);
    for (format, name) in [(Format::Csv, "a.csv"), (Format::Parquet, "a.parquet"), (Format::Mat, "a.mat")] {
        let path = folder.path().join(name);
        fs::write(&path, "before").unwrap();
        let targets = [(format, path.clone())];
        let result = export(&source, &Selection::default(), &targets, true, None, &mut |_| Err(Error::Interrupted));
        assert!(matches!(result, Err(Error::Interrupted)), "{result:?}");
        let nothing = Selection { range_s: 7.0..8.0, ..Selection::default() };
        let result = export(&source, &nothing, &targets, true, None, &mut |_| Ok(()));
        assert!(matches!(result, Err(Error::Recording(RecordingError::EmptyRange { .. }))), "{result:?}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "before");
    }
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 4, "no half-written files: {left:?}");
}

#[test]
fn parts_make_the_whole() {
    let (_folder, _, source) = recorded(false);
    let count = |range_s: Range<f64>| {
        let selection = Selection { columns: None, range_s };
        match write_csv(&source, &selection, "nowhere", std::io::sink(), &mut |_| Ok(())) {
            Err(Error::Recording(RecordingError::EmptyRange { .. })) => 0,
            rows => rows.unwrap(),
        }
    };
    assert_eq!(count(0.0..f64::INFINITY), 5000);
    assert_eq!((count(0.0..1.001), count(1.001..5.0), count(4.999..9.0), count(4.9991..9.0)), (1001, 3999, 1, 0));
}
