//! A store: adds, finds, verifies and removes runs.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::{self, Write},
    path::{Path, PathBuf},
};

use inerter_data::output::Pending;
use serde_json::{Map, Value, json};

use crate::{
    choice::Choice,
    error::{StoreError, unreadable},
    files::{Files, SMALL, found},
    folder::Folder,
    place::{LONGEST_MARK, MARK, Part, Place, RESULTS, VERSION},
    results::{LONGEST_RESULT, Outcome, checked},
    row::{LONGEST_ROW, MOST_COLUMNS, Row},
    sums::{Expected, Sum, parse},
    tables::{Tables, opened},
};

/// How often a run is written again if another process removes it meanwhile.
const ATTEMPTS: usize = 4;

/// The problem of a file that the system cannot read.
const UNREADABLE: &str = "unreadable";
/// The problem of a row that is too long or has too many columns.
const OVERSIZED: &str = "oversized";

/// A store of runs, in a folder or at `s3://BUCKET/FOLDER`.
pub struct Store {
    url: String,
    files: Box<dyn Files>,
}

/// The outcome of adding a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Added {
    /// Its row.
    pub row: Row,
    /// False if the run already existed.
    pub is_new: bool,
}

/// Some runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Listed {
    /// The selected runs, by device, date and name.
    pub rows: Vec<Row>,
    /// Rows that cannot be read.
    pub damages: Vec<Damage>,
}

/// The result of a check of every file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verified {
    /// Number of runs.
    pub runs: usize,
    /// Files that have changed since they were written.
    pub damages: Vec<Damage>,
}

/// A file that has changed since it was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// The run; empty for a file that belongs to none.
    pub run: String,
    /// The file, from the root of the store.
    pub file: String,
    /// `missing`, `changed`, `unreadable`, `oversized` (a row that is too long or has too many columns), `unfinished`
    /// (a run whose adding or removal was interrupted) or `foreign` (not ours).
    pub problem: &'static str,
}

/// A recording as a local file.
#[derive(Debug)]
pub struct Local {
    file: PathBuf,
    _fetched: Option<tempfile::TempDir>,
}

impl Local {
    /// The file.
    pub fn path(&self) -> &Path {
        &self.file
    }
}

/// Called with the completed fraction, from 0 to 1; an error stops the work.
pub type Progress<'a> = &'a mut dyn FnMut(f64) -> Result<(), StoreError>;

impl Store {
    /// Opens an existing store.
    pub fn open(url: &str) -> Result<Self, StoreError> {
        let store = Self::at(url)?;
        if store.is_there()? { Ok(store) } else { Err(StoreError::None { url: url.into() }) }
    }

    /// Opens a store, or a place for one: the first run creates it.
    pub fn create(url: &str) -> Result<Self, StoreError> {
        let store = Self::at(url)?;
        // Another process may have created it between the two checks.
        if !store.is_there()? && !store.tried("it", "listed", store.files.is_empty())? && !store.is_there()? {
            return Err(StoreError::Foreign { url: url.into() });
        }
        Ok(store)
    }

    fn at(url: &str) -> Result<Self, StoreError> {
        let refused = |problem: &str, help: &str| StoreError::Address {
            url: url.into(),
            problem: problem.into(),
            help: help.into(),
        };
        let files: Box<dyn Files> = match url.split_once("://") {
            None if url.is_empty() => return Err(refused("it is empty", "name a folder, or s3://BUCKET/FOLDER")),
            None => Box::new(Folder::new(PathBuf::from(url))),
            #[cfg(feature = "s3")]
            Some(("s3", bucket)) => Box::new(crate::s3::Bucket::new(bucket).map_err(|error| {
                let help = "write s3://BUCKET/FOLDER, and set AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT";
                refused(&error.to_string(), help)
            })?),
            #[cfg(not(feature = "s3"))]
            Some(("s3", _)) => {
                let help = "use the program of a release or the Python package, or build it with `--features s3`";
                return Err(refused("this program was built without S3", help));
            }
            Some(_) => return Err(refused("there is no such kind of store", "name a folder, or s3://BUCKET/FOLDER")),
        };
        Ok(Self { url: url.into(), files })
    }

    /// The address.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Whether there is a store that this version can read.
    fn is_there(&self) -> Result<bool, StoreError> {
        if !self.has(MARK)? {
            return Ok(false);
        }
        let mark = self.tried(MARK, "read", self.files.get_up_to(MARK, LONGEST_MARK))?.unwrap_or_default();
        let mark: Value = serde_json::from_slice(&mark).unwrap_or_default();
        match mark["version"].as_u64().filter(|_| mark["kind"] == "inerter-store") {
            Some(version) if version > VERSION => Err(StoreError::Newer { url: self.url.clone(), version }),
            Some(_) => Ok(true),
            None => Err(self.damaged(MARK, "it does not say which version it is")),
        }
    }

    /// Adds a recording; adding the same one twice gives one run. `progress` gets the completed fraction and may stop
    /// the work until the run exists.
    pub fn add(&self, recording: &Path, progress: Progress<'_>) -> Result<Added, StoreError> {
        let mut sum = Sum::default();
        File::open(recording).and_then(|mut file| io::copy(&mut file, &mut sum)).map_err(unreadable(recording))?;
        let source = opened(recording)?;
        let place = Place::of(&source, sum.hex());
        if self.has_run(&place)?
            && self.has_sum(&place.file(Part::Recording), &place.run)
            && let Ok(row) = self.row(&place)
        {
            return Ok(Added { row, is_new: false });
        }
        let tables = Tables::of(&source, place, progress)?;
        self.write(recording, &tables, progress)?;
        Ok(Added { row: self.row(&tables.place)?, is_new: true })
    }

    /// Writes the files that are missing or invalid; `progress` is called until the run exists.
    fn write(&self, recording: &Path, tables: &Tables, progress: Progress<'_>) -> Result<(), StoreError> {
        let place = &tables.place;
        if !self.has(MARK)? {
            self.put(MARK, format!("{}\n", json!({ "kind": "inerter-store", "version": VERSION })).as_bytes())?;
        }
        let name = place.file(Part::Recording);
        for _ in 0..ATTEMPTS {
            progress(1.0)?;
            // A file that cannot be read is written again.
            if !self.has_sum(&name, &place.run) {
                let file = File::open(recording).map_err(unreadable(recording))?;
                let mut from = Expected::new(file, &place.run);
                let put = self.files.put(&name, &mut from);
                if from.is_other {
                    return Err(StoreError::Changed { path: recording.into() });
                }
                self.tried(&name, "written", put)?;
            }
            for (part, bytes) in &tables.files {
                progress(1.0)?;
                let name = place.file(*part);
                if !self.has_sum(&name, &Sum::of(bytes)) {
                    // The last one is the run's row: after it the run exists.
                    self.put(&name, bytes)?;
                }
            }
            // Unless another process removed it meanwhile, or another version added it.
            let sums = place.file(Part::Sums);
            let is_ours = self.sum(&sums)? == Some(Sum::of(tables.bytes(Part::Sums)));
            if Part::ALL
                .iter()
                .try_fold(is_ours, |all, part| Ok::<_, StoreError>(self.has(&place.file(*part))? && all))?
            {
                return Ok(());
            }
        }
        Err(self.damaged(&name, "another process keeps removing this run, or another version keeps adding it"))
    }

    /// The selected runs; all rows are in memory meanwhile.
    pub fn runs(&self, choice: &Choice) -> Result<Listed, StoreError> {
        let mut listed = Listed::default();
        let mut all = Vec::new();
        // All rows are needed to know which columns exist.
        let are_asked = |place: &Place| !choice.conditions.is_empty() || choice.may_be(place);
        for place in self.places()?.into_iter().filter(are_asked) {
            let problem = match self.row(&place) {
                Ok(row) => {
                    all.push(row);
                    continue;
                }
                Err(StoreError::Damaged { .. }) => "changed",
                Err(StoreError::LongRow { .. }) => OVERSIZED,
                Err(StoreError::Access { source, .. }) if source.kind() == io::ErrorKind::NotFound => "missing",
                Err(_) if self.is_local() => UNREADABLE,
                Err(error) => return Err(error),
            };
            // Unless it was removed meanwhile.
            if choice.may_be(&place) && self.has_run(&place)? {
                listed.damages.push(Damage::of(&place, Part::Row, problem));
            }
        }
        choice.conditions.iter().try_for_each(|condition| condition.check(&all))?;
        let (mut is_understood, mut refused) = (false, None);
        for row in all {
            match choice.is(&row) {
                Ok(is_met) => {
                    is_understood = true;
                    if is_met && choice.may_be(&row.place) {
                        listed.rows.push(row);
                    }
                }
                Err(error) => refused = Some(error),
            }
        }
        // An unusual row must not hide the others.
        refused.filter(|_| !is_understood).map_or(Ok(listed), Err)
    }

    /// The run whose name begins like this, found by a search through all; or the run with this [`Place::key`], whether
    /// or not it exists.
    pub fn find(&self, beginning: &str) -> Result<Place, StoreError> {
        let none = || StoreError::NoRun { url: self.url.clone(), run: beginning.into() };
        if let Some(place) = Place::parse_key(beginning) {
            return if self.has_run(&place)? { Ok(place) } else { Err(none()) };
        }
        let run = beginning.to_lowercase();
        let found = self.places()?.into_iter().filter(|place| place.run.starts_with(&run) && !run.is_empty());
        match <[Place; 1]>::try_from(found.collect::<Vec<_>>()) {
            Ok([place]) => Ok(place),
            Err(all) if all.is_empty() => Err(none()),
            Err(all) => Err(StoreError::Ambiguous { url: self.url.clone(), run: beginning.into(), count: all.len() }),
        }
    }

    /// The row of a run.
    pub fn row(&self, place: &Place) -> Result<Row, StoreError> {
        let name = place.file(Part::Row);
        let too_long = || StoreError::LongRow { url: self.url.clone(), file: name.clone() };
        let bytes = self.tried(&name, "read", self.files.get_up_to(&name, LONGEST_ROW))?.ok_or_else(too_long)?;
        match serde_json::from_slice(&bytes) {
            Ok(Value::Object(values)) if values.len() > MOST_COLUMNS => Err(too_long()),
            Ok(Value::Object(values)) => Ok(Row { place: place.clone(), values }),
            _ => Err(self.damaged(&name, "it is not a JSON object")),
        }
    }

    /// The path of a run's recording, if it is local.
    pub fn file(&self, place: &Place) -> Option<PathBuf> {
        self.files.file(&place.file(Part::Recording))
    }

    /// The recording of a run as a local file: the store's own, or a downloaded copy that is removed when dropped.
    pub fn local(&self, place: &Place) -> Result<Local, StoreError> {
        if let Some(file) = self.file(place) {
            return Ok(Local { file, _fetched: None });
        }
        let failed = |source| self.access("a temporary file", "written", source);
        let folder = tempfile::Builder::new().prefix("inerter-").tempdir().map_err(failed)?;
        let file = folder.path().join("run.mcap");
        self.get(place, &file, false)?;
        Ok(Local { file, _fetched: Some(folder) })
    }

    /// Copies the recording of a run into a file. Replaces an existing file only with `replace`.
    pub fn get(&self, place: &Place, file: &Path, replace: bool) -> Result<(), StoreError> {
        let name = place.file(Part::Recording);
        let pending = Pending::create(file, replace)?;
        let mut to = pending.open()?;
        let (mut sum, mut unwritten) = (Sum::default(), None);
        let read = self.files.read(&name, &mut |part| {
            sum.write_all(part)?;
            to.write_all(part).map_err(|error| {
                unwritten = Some(error);
                io::ErrorKind::Other.into()
            })
        });
        if let Some(error) = unwritten {
            return Err(inerter_data::output::OutputError::write(pending.name(), error).into());
        }
        read.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => self.damaged(&name, "it is missing"),
            _ => self.access(&name, "read", error),
        })?;
        if sum.hex() != place.run {
            return Err(self.damaged(&name, "it differs from what was added"));
        }
        pending.commit()?;
        Ok(())
    }

    /// Reads every file of every run, and lists those that have changed since they were written.
    pub fn verify(&self, progress: Progress<'_>) -> Result<Verified, StoreError> {
        // Before the runs, so that files completed meanwhile count as complete.
        let mut others = self.others()?;
        let whole = self.places()?;
        let mut damages = Vec::new();
        for (number, place) in whole.iter().enumerate() {
            progress(number as f64 / whole.len() as f64)?;
            let mut own = self.verified(place)?;
            if !own.is_empty() && self.has(&place.file(Part::Run))? {
                damages.append(&mut own);
            }
        }
        others.retain(|(place, _)| place.as_ref().is_none_or(|place| whole.binary_search(place).is_err()));
        damages.extend(others.into_iter().map(|(_, damage)| damage));
        progress(1.0)?;
        Ok(Verified { runs: whole.len(), damages })
    }

    /// What is wrong with the files of a run.
    fn verified(&self, place: &Place) -> Result<Vec<Damage>, StoreError> {
        let sums = place.file(Part::Sums);
        let text = match found(self.files.get_up_to(&sums, SMALL)) {
            // One that is far too long is not ours.
            Ok(bytes) => bytes.map(|bytes| String::from_utf8_lossy(&bytes.unwrap_or_default()).into_owned()),
            Err(_) if self.is_local() => Some(String::new()),
            Err(error) => return Err(self.access(&sums, "read", error)),
        };
        let expected: BTreeMap<String, String> = parse(text.as_deref().unwrap_or_default()).into_iter().collect();
        let summed: Vec<Part> = Part::ALL.into_iter().filter(|part| *part != Part::Sums).collect();
        let is_complete = summed.iter().all(|part| expected.contains_key(&place.file(*part)))
            && expected.get(&place.file(Part::Recording)) == Some(&place.run)
            && text.as_ref().is_some_and(|text| text.lines().count() == summed.len() && text.ends_with('\n'));
        let mut damages = Vec::new();
        if !is_complete {
            damages.push(Damage::of(place, Part::Sums, if text.is_none() { "missing" } else { "changed" }));
        }
        for part in summed {
            let name = place.file(part);
            // The recording's sum is the run's name.
            let wanted = if part == Part::Recording { Some(&place.run) } else { expected.get(&name) };
            match self.sum(&name) {
                Ok(None) => damages.push(Damage::of(place, part, "missing")),
                Ok(Some(sum)) if wanted.is_some_and(|wanted| *wanted != sum) => {
                    damages.push(Damage::of(place, part, "changed"));
                }
                // Another program may have written such a row together with its sum.
                Ok(Some(_)) if part == Part::Row && matches!(self.row(place), Err(StoreError::LongRow { .. })) => {
                    damages.push(Damage::of(place, part, OVERSIZED));
                }
                Ok(Some(_)) => {}
                Err(_) if self.is_local() => damages.push(Damage::of(place, part, UNREADABLE)),
                Err(error) => return Err(error),
            }
        }
        Ok(damages)
    }

    /// Whether its files are local: then an unreadable file is damaged, and the network is not to blame.
    fn is_local(&self) -> bool {
        self.files.file(MARK).is_some()
    }

    /// Files that belong to an incomplete run, or to none.
    fn others(&self) -> Result<Vec<(Option<Place>, Damage)>, StoreError> {
        let results = format!("{RESULTS}/");
        let ours = |file: &String| file != MARK && !file.starts_with(&results);
        let judged = |file: String| match Part::ALL.iter().find_map(|part| Some((*part, Place::parse(&file, *part)?))) {
            Some((Part::Run, _)) => None,
            Some((_, place)) => {
                let damage = Damage { run: place.run.clone(), file, problem: "unfinished" };
                Some((Some(place), damage))
            }
            None => Some((None, Damage { run: String::new(), file, problem: "foreign" })),
        };
        Ok(self.list("")?.into_iter().filter(ours).filter_map(judged).collect())
    }

    /// Rebuilds the derived files of intact recordings, and removes the remains of others; returns how many runs were
    /// completed. A damaged recording stays as it is, and so does one that this version cannot use.
    pub fn repair(&self, progress: Progress<'_>) -> Result<usize, StoreError> {
        let damages = self.verify(progress)?.damages;
        let place = |damage: &Damage| Part::ALL.iter().find_map(|part| Place::parse(&damage.file, *part));
        let places: BTreeSet<Place> = damages.iter().filter_map(place).collect();
        let mut whole = 0;
        for place in &places {
            match self.sum(&place.file(Part::Recording)) {
                Ok(Some(sum)) if sum == place.run => {
                    let local = self.local(place)?;
                    let tables = opened(local.path()).and_then(|source| {
                        let place = Place::of(&source, place.run.clone());
                        Tables::of(&source, place, progress)
                    });
                    match tables {
                        // Each file appears only when complete, so nothing is lost if this is interrupted.
                        Ok(tables) => self.write(local.path(), &tables, progress)?,
                        Err(StoreError::Data(inerter_data::Error::Interrupted)) => {
                            return Err(inerter_data::Error::Interrupted.into());
                        }
                        Err(_) => continue,
                    }
                    whole += 1;
                }
                Ok(None) if !self.has_run(place)? => self.remove(place)?,
                Ok(_) => {}
                Err(_) if self.is_local() => {}
                Err(error) => return Err(error),
            }
        }
        self.tried("an unfinished file", "removed", self.files.remove_unfinished())?;
        Ok(whole)
    }

    /// Removes a run with its recording and its results; it stops being a run at the first step.
    pub fn remove(&self, place: &Place) -> Result<(), StoreError> {
        let results = self.batches()?.into_iter().map(|batch| place.result(&batch));
        let others = Part::ALL.iter().rev().skip(1).map(|part| place.file(*part));
        [place.file(Part::Run)].into_iter().chain(results).chain(others).try_for_each(|name| self.remove_file(&name))
    }

    /// Saves the outcome of a run, replacing an earlier one in the same batch.
    pub fn keep(&self, batch: &str, place: &Place, outcome: &Outcome) -> Result<(), StoreError> {
        self.put(&place.result(checked(batch)?), format!("{}\n", outcome.json(place)).as_bytes())
    }

    /// Names of the runs that a batch already has; an error if they were made in another way.
    pub fn kept(&self, batch: &str, kind: &str, given: &Value) -> Result<BTreeSet<String>, StoreError> {
        let mut runs = BTreeSet::new();
        self.each_result(batch, &mut |run, row| {
            if row.get("kind") != Some(&json!(kind)) || row.get("given") != Some(given) {
                let word = |name: &str| row.get(name).map(Value::to_string).unwrap_or_default();
                return Err(StoreError::OtherBatch { name: batch.into(), kind: word("kind"), given: word("given") });
            }
            runs.insert(run);
            Ok(())
        })?;
        Ok(runs)
    }

    /// Passes the outcomes in a batch to `take`, each with the name of its run: `run`, `kind`, `software`, `given`,
    /// `code`, `error` and `result`, the last three null where absent. A file that is unreadable, damaged or too long
    /// counts as missing. One at a time is in memory; an error of `take` ends it.
    pub fn each_result(
        &self,
        batch: &str,
        take: &mut dyn FnMut(String, Map<String, Value>) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        for (place, name) in self.results_of(batch)? {
            match self.files.get_up_to(&name, LONGEST_RESULT) {
                Ok(bytes) => {
                    if let Ok(Value::Object(values)) = serde_json::from_slice(&bytes.unwrap_or_default()) {
                        take(place.run, values)?;
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::NotFound || self.is_local() => {}
                Err(error) => return Err(self.access(&name, "read", error)),
            }
        }
        Ok(())
    }

    /// Names of the batches.
    pub fn batches(&self) -> Result<BTreeSet<String>, StoreError> {
        let names = self.list(RESULTS)?;
        let named = names.iter().filter_map(|name| name.split('/').nth(1));
        Ok(named.filter(|batch| checked(batch).is_ok()).map(str::to_owned).collect())
    }

    fn results_of(&self, batch: &str) -> Result<Vec<(Place, String)>, StoreError> {
        let names = self.list(&format!("{RESULTS}/{}", checked(batch)?))?;
        Ok(names.into_iter().filter_map(|name| Some((Place::parse_result(&name, batch)?, name))).collect())
    }

    /// Whether the run exists.
    pub fn has_run(&self, place: &Place) -> Result<bool, StoreError> {
        self.has(&place.file(Part::Run))
    }

    /// Places of all runs, in order.
    pub fn places(&self) -> Result<Vec<Place>, StoreError> {
        let names = self.list(Part::Run.folder())?;
        let mut places: Vec<Place> = names.iter().filter_map(|name| Place::parse(name, Part::Run)).collect();
        places.sort();
        Ok(places)
    }

    /// The sum of a file, if it exists.
    fn sum(&self, name: &str) -> Result<Option<String>, StoreError> {
        let mut sum = Sum::default();
        let read = self.files.read(name, &mut |part| sum.write_all(part));
        Ok(self.tried(name, "read", found(read))?.map(|()| sum.hex()))
    }

    fn has_sum(&self, name: &str, sum: &str) -> bool {
        self.sum(name).is_ok_and(|found| found.as_deref() == Some(sum))
    }

    fn has(&self, name: &str) -> Result<bool, StoreError> {
        self.tried(name, "read", self.files.has(name))
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        let name = if folder.is_empty() { "it" } else { folder };
        self.tried(name, "listed", self.files.list(folder))
    }

    fn put(&self, name: &str, mut bytes: &[u8]) -> Result<(), StoreError> {
        self.tried(name, "written", self.files.put(name, &mut bytes))
    }

    fn remove_file(&self, name: &str) -> Result<(), StoreError> {
        self.tried(name, "removed", self.files.remove(name))
    }

    /// The result of an operation on a file, with an error that names the file.
    fn tried<T>(&self, file: &str, action: &'static str, result: io::Result<T>) -> Result<T, StoreError> {
        result.map_err(|error| self.access(file, action, error))
    }

    fn access(&self, file: &str, action: &'static str, source: io::Error) -> StoreError {
        StoreError::Access { url: self.url.clone(), file: file.into(), action, source }
    }

    fn damaged(&self, file: &str, problem: &str) -> StoreError {
        StoreError::Damaged { url: self.url.clone(), file: file.into(), problem: problem.into() }
    }
}

impl Damage {
    fn of(place: &Place, part: Part, problem: &'static str) -> Self {
        Self { run: place.run.clone(), file: place.file(part), problem }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sums::lines;

    fn mark() -> String {
        json!({ "kind": "inerter-store", "version": VERSION }).to_string()
    }

    fn created(folder: &Path) -> Store {
        Store::create(folder.to_str().unwrap()).unwrap()
    }

    fn place(run: String) -> Place {
        Place { device: "SIM-1".into(), date: "2026-01-02".into(), run }
    }

    /// A store with one run, which has this row.
    fn stored(folder: &Path, row: &str) -> (Store, Place) {
        let store = created(folder);
        store.put(MARK, mark().as_bytes()).unwrap();
        let place = place(Sum::of(b"recording"));
        let mut summed = Vec::new();
        for part in Part::ALL {
            let bytes: &[u8] = match part {
                Part::Recording => b"recording",
                Part::Row => row.as_bytes(),
                _ => b"",
            };
            if part != Part::Sums {
                store.put(&place.file(part), bytes).unwrap();
                summed.push((place.file(part), Sum::of(bytes)));
            }
        }
        store.put(&place.file(Part::Sums), lines(&summed).as_bytes()).unwrap();
        (store, place)
    }

    /// `most` is a row that is just small enough, `more` one that is not.
    fn assert_oversized(most: &str, more: &str) {
        let folder = tempfile::tempdir().unwrap();
        let (store, place) = stored(folder.path(), most);
        let expected: Map<String, Value> = serde_json::from_str(most).unwrap();
        assert!(store.row(&place).unwrap().values == expected);
        assert!(store.verify(&mut |_| Ok(())).unwrap().damages.is_empty());

        let (store, place) = stored(folder.path(), more);
        let name = place.file(Part::Row);
        let error = store.row(&place).unwrap_err();
        assert!(matches!(&error, StoreError::LongRow { file, .. } if *file == name), "{error}");
        let damage = Damage { run: place.run.clone(), file: name.clone(), problem: OVERSIZED };
        let listed = store.runs(&Choice::default()).unwrap();
        assert_eq!((listed.rows.len(), listed.damages.as_slice()), (0, [damage.clone()].as_slice()));
        assert_eq!(store.verify(&mut |_| Ok(())).unwrap().damages, [damage]);
        assert_eq!(store.sum(&name).unwrap(), Some(Sum::of(more.as_bytes())));
    }

    #[test]
    fn a_row_that_is_too_long_is_not_read_and_stays_as_it_is() {
        let row = |length: usize| {
            let row = format!("{{\"law\":\"{}\"}}", "x".repeat(length - 10));
            assert_eq!(row.len(), length);
            row
        };
        assert_oversized(&row(LONGEST_ROW), &row(LONGEST_ROW + 1));
    }

    #[test]
    fn a_row_of_too_many_columns_is_not_used_and_stays_as_it_is() {
        let row = |columns: usize| {
            let values: Map<String, Value> = (0..columns).map(|number| (format!("x{number}"), json!(number))).collect();
            Value::Object(values).to_string()
        };
        assert_oversized(&row(MOST_COLUMNS), &row(MOST_COLUMNS + 1));
    }

    #[test]
    fn a_mark_that_is_too_long_is_not_ours() {
        let folder = tempfile::tempdir().unwrap();
        let url = folder.path().to_str().unwrap();
        // JSON may end with spaces.
        for (length, is_ours) in [(LONGEST_MARK, true), (LONGEST_MARK + 1, false)] {
            let store = Store::at(url).unwrap();
            store.put(MARK, format!("{:<length$}", mark()).as_bytes()).unwrap();
            match Store::open(url) {
                Ok(_) => assert!(is_ours),
                Err(error) => assert!(!is_ours && matches!(&error, StoreError::Damaged { .. }), "{error}"),
            }
        }
    }

    #[test]
    fn a_result_that_is_too_long_hides_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let store = created(folder.path());
        for (digit, length) in [("a", LONGEST_RESULT + 1), ("b", LONGEST_RESULT)] {
            let mut text = br#"{"kind":"replay","given":{}}"#.to_vec();
            text.resize(length, b' ');
            store.put(&place(digit.repeat(64)).result("all"), &text).unwrap();
        }
        let names = BTreeSet::from(["b".repeat(64)]);
        let mut passed = BTreeSet::new();
        let all = store.each_result("all", &mut |run, _| {
            passed.insert(run);
            Ok(())
        });
        assert!(all.is_ok());
        assert_eq!(passed, names);
        assert_eq!(store.kept("all", "replay", &json!({})).unwrap(), names);
    }

    #[test]
    fn results_come_one_by_one_until_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let store = created(folder.path());
        let result = |digit: &str| place(digit.repeat(64)).result("all");
        for digit in ["a", "b", "c"] {
            store.put(&result(digit), br#"{"kind":"replay","given":{}}"#).unwrap();
        }
        // What is removed once the first has come does not come: none is read before its turn.
        let mut passed = Vec::new();
        let all = store.each_result("all", &mut |run, _| {
            passed.push(run);
            store.remove_file(&result("b"))
        });
        assert!(all.is_ok());
        assert_eq!(passed, ["a", "c"].map(|digit| digit.repeat(64)));

        let mut count = 0;
        let refused = store.each_result("all", &mut |_, _| {
            count += 1;
            Err(StoreError::Batch { name: "all".into() })
        });
        assert!(refused.is_err() && count == 1, "{count}");
    }
}
