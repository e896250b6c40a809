//! A store: runs go in, are found, checked and removed.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io,
    path::{Path, PathBuf},
};

use inerter_data::output::Pending;
use serde_json::{Map, Value, json};

use crate::{
    choice::Choice,
    error::StoreError,
    files::Files,
    folder::Folder,
    place::{MARK, Part, Place, RESULTS, VERSION},
    results::{Outcome, checked},
    row::Row,
    sums::{Expected, Sum, Summed, parse},
    tables::Tables,
};

/// A run that another process removes while it is added is written anew so often.
const ATTEMPTS: usize = 4;

/// A store of runs, in a folder or at `s3://BUCKET/FOLDER`.
pub struct Store {
    url: String,
    files: Box<dyn Files>,
}

/// What became of a recording that was added.
#[derive(Clone, Debug, PartialEq)]
pub struct Added {
    /// Its row.
    pub row: Row,
    /// False where the run was there already.
    pub is_new: bool,
}

/// Some runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Listed {
    /// Those that are meant, by device, date and name.
    pub rows: Vec<Row>,
    /// Rows that cannot be read.
    pub damages: Vec<Damage>,
}

/// What a look at every file found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verified {
    /// Runs that are there.
    pub runs: usize,
    /// Files that are not as they were written.
    pub damages: Vec<Damage>,
}

/// A file that is not as it was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// The run; empty for a file of none.
    pub run: String,
    /// The file, from the root of the store.
    pub file: String,
    /// `missing`, `changed`, `unfinished` (of a run that was not added, or not removed, to its end) or `foreign` (nothing of ours).
    pub problem: &'static str,
}

/// A recording on this computer.
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

/// Hears of the part of the work that is done, from 0 to 1; an error ends it.
pub type Progress<'a> = &'a mut dyn FnMut(f64) -> Result<(), StoreError>;

impl Store {
    /// Opens a store that is there.
    pub fn open(url: &str) -> Result<Self, StoreError> {
        let store = Self::at(url)?;
        if store.is_there()? { Ok(store) } else { Err(StoreError::None { url: url.into() }) }
    }

    /// Opens a store, or a place where one can be: the first run makes it.
    pub fn create(url: &str) -> Result<Self, StoreError> {
        let store = Self::at(url)?;
        // Another process may have made it between the first look and the second.
        if !store.is_there()?
            && !store.files.is_empty().map_err(|error| store.access("it", "listed", error))?
            && !store.is_there()?
        {
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

    /// Whether a store is there that this version can read.
    fn is_there(&self) -> Result<bool, StoreError> {
        if !self.has(MARK)? {
            return Ok(false);
        }
        let mark: Value = serde_json::from_slice(&self.bytes(MARK)?).unwrap_or_default();
        match mark["version"].as_u64().filter(|_| mark["kind"] == "inerter-store") {
            Some(version) if version > VERSION => Err(StoreError::Newer { url: self.url.clone(), version }),
            Some(_) => Ok(true),
            None => Err(self.damaged(MARK, "it does not say which version it is")),
        }
    }

    /// Adds a recording: the same one twice is one run. `progress` is handed the part that is done and may end the work until the
    /// run is there.
    pub fn add(&self, recording: &Path, progress: Progress<'_>) -> Result<Added, StoreError> {
        let unreadable = |source| inerter_data::recording::RecordingError::Read { path: recording.into(), source };
        let unreadable = |source| StoreError::from(inerter_data::Error::from(unreadable(source)));
        let mut before = Summed::new(File::open(recording).map_err(unreadable)?);
        io::copy(&mut before, &mut io::sink()).map_err(unreadable)?;
        let run = before.sum.hex();
        if let Some(place) = self.places()?.into_iter().find(|place| place.run == run)
            && let Ok(row) = self.row(&place)
        {
            return Ok(Added { row, is_new: false });
        }
        let tables = Tables::of(recording, &run, progress)?;
        let place = &tables.place;
        if !self.has(MARK)? {
            self.put(MARK, format!("{}\n", json!({ "kind": "inerter-store", "version": VERSION })).as_bytes())?;
        }
        let name = place.file(Part::Recording);
        for _ in 0..ATTEMPTS {
            progress(1.0)?;
            // What cannot be read is written.
            let is_there =
                |name: &str, sum: &str| self.sum(name).is_ok_and(|found| found.is_some_and(|found| found == sum));
            if !is_there(&name, &run) {
                let mut from = Expected::new(File::open(recording).map_err(unreadable)?, &run);
                let put = self.files.put(&name, &mut from);
                if from.is_other {
                    return Err(StoreError::Changed { path: recording.into() });
                }
                put.map_err(|error| self.access(&name, "written", error))?;
            }
            for (part, bytes) in tables.before_the_run() {
                let name = place.file(part);
                if !is_there(&name, &Sum::of(bytes)) {
                    self.put(&name, bytes)?;
                }
            }
            progress(1.0)?;
            // From here on it is there.
            self.put(&place.file(Part::Run), tables.bytes(Part::Run))?;
            // Unless another process removed it meanwhile, or another version added it.
            let sums =
                self.has(&place.file(Part::Sums))? && self.bytes(&place.file(Part::Sums))? == tables.bytes(Part::Sums);
            let is_whole = Part::ALL
                .iter()
                .try_fold(sums, |all, part| Ok::<_, StoreError>(self.has(&place.file(*part))? && all))?;
            if is_whole {
                return Ok(Added { row: self.row(place)?, is_new: true });
            }
        }
        Err(self.damaged(&name, "another process removes this run, or another version adds it, again and again"))
    }

    /// The runs that are meant.
    pub fn runs(&self, choice: &Choice) -> Result<Listed, StoreError> {
        let mut listed = Listed::default();
        let mut all = Vec::new();
        // Which columns there are, all rows together say.
        let are_asked = |place: &Place| !choice.conditions.is_empty() || choice.may_be(place);
        for place in self.places()?.into_iter().filter(are_asked) {
            match self.row(&place) {
                Ok(row) => all.push(row),
                // It was removed meanwhile.
                Err(_) if !self.has(&place.file(Part::Run))? => {}
                Err(StoreError::Damaged { .. }) => listed.damages.push(Damage::of(&place, Part::Row, "changed")),
                Err(StoreError::Access { source, .. }) if source.kind() == io::ErrorKind::NotFound => {
                    listed.damages.push(Damage::of(&place, Part::Row, "missing"));
                }
                Err(error) => return Err(error),
            }
        }
        choice.conditions.iter().try_for_each(|condition| condition.check(&all))?;
        for row in all.into_iter().filter(|row| choice.may_be(&row.place)) {
            if choice.is(&row)? {
                listed.rows.push(row);
            }
        }
        Ok(listed)
    }

    /// The run whose name begins like this.
    pub fn find(&self, beginning: &str) -> Result<Place, StoreError> {
        let run = beginning.to_lowercase();
        let found = self.places()?.into_iter().filter(|place| place.run.starts_with(&run) && !run.is_empty());
        match <[Place; 1]>::try_from(found.collect::<Vec<_>>()) {
            Ok([place]) => Ok(place),
            Err(none) if none.is_empty() => Err(StoreError::NoRun { url: self.url.clone(), run: beginning.into() }),
            Err(all) => Err(StoreError::Ambiguous { url: self.url.clone(), run: beginning.into(), count: all.len() }),
        }
    }

    /// What the store says of a run.
    pub fn row(&self, place: &Place) -> Result<Row, StoreError> {
        let name = place.file(Part::Row);
        match serde_json::from_slice(&self.bytes(&name)?) {
            Ok(Value::Object(values)) => Ok(Row { place: place.clone(), values }),
            _ => Err(self.damaged(&name, "it is no JSON object")),
        }
    }

    /// The file with the recording of a run, where that is one of this computer.
    pub fn file(&self, place: &Place) -> Option<PathBuf> {
        self.files.file(&place.file(Part::Recording))
    }

    /// The recording of a run as a file of this computer: the store's own, or one that is fetched and goes when it is dropped.
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

    /// Writes the recording of a run into a file; only `replace` lets it take the place of one that is there.
    pub fn get(&self, place: &Place, file: &Path, replace: bool) -> Result<(), StoreError> {
        let name = place.file(Part::Recording);
        let pending = Pending::create(file, replace)?;
        let mut to = pending.open()?;
        let (mut sum, mut unwritten) = (Sum::default(), None);
        let read = self.files.read(&name, &mut |part| {
            sum.take(part);
            io::Write::write_all(&mut to, part).map_err(|error| {
                unwritten = Some(error);
                io::ErrorKind::Other.into()
            })
        });
        if let Some(error) = unwritten {
            return Err(inerter_data::output::OutputError::write(pending.name(), error).into());
        }
        read.map_err(|error| self.access(&name, "read", error))?;
        if sum.hex() != place.run {
            return Err(self.damaged(&name, "it is not what was added"));
        }
        pending.commit()?;
        Ok(())
    }

    /// Reads every file of every run, and lists what is not as it was written.
    pub fn verify(&self, progress: Progress<'_>) -> Result<Verified, StoreError> {
        // Before the runs: what is completed meanwhile is whole.
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
        others.retain(|damage| damage.problem != "unfinished" || whole.iter().all(|place| place.run != damage.run));
        damages.append(&mut others);
        progress(1.0)?;
        Ok(Verified { runs: whole.len(), damages })
    }

    /// What is wrong with the files of a run.
    fn verified(&self, place: &Place) -> Result<Vec<Damage>, StoreError> {
        let sums = place.file(Part::Sums);
        let expected: BTreeMap<String, String> = match self.has(&sums)? {
            true => parse(&String::from_utf8_lossy(&self.bytes(&sums)?)).into_iter().collect(),
            false => BTreeMap::new(),
        };
        let summed = Part::ALL.iter().filter(|part| **part != Part::Sums).map(|part| place.file(*part));
        let mut damages = Vec::new();
        if !self.has(&sums)? {
            damages.push(Damage::of(place, Part::Sums, "missing"));
        } else if !expected.keys().cloned().collect::<BTreeSet<_>>().is_superset(&summed.collect()) {
            damages.push(Damage::of(place, Part::Sums, "changed"));
        }
        for part in Part::ALL.into_iter().filter(|part| *part != Part::Sums) {
            let name = place.file(part);
            // The recording is named by its own.
            let wanted = if part == Part::Recording { Some(&place.run) } else { expected.get(&name) };
            match self.sum(&name)? {
                None => damages.push(Damage::of(place, part, "missing")),
                Some(sum) if wanted.is_some_and(|wanted| *wanted != sum) => {
                    damages.push(Damage::of(place, part, "changed"));
                }
                Some(_) => {}
            }
        }
        Ok(damages)
    }

    /// Files of what is no run, and of nobody.
    fn others(&self) -> Result<Vec<Damage>, StoreError> {
        let mut found = Vec::new();
        for file in self.list("")?.into_iter().filter(|file| file != MARK && !file.starts_with(&format!("{RESULTS}/")))
        {
            let place = Part::ALL.iter().find_map(|part| Some((*part, Place::parse(&file, *part)?)));
            match place {
                Some((Part::Run, _)) => {}
                Some((_, place)) => found.push(Damage { run: place.run, file, problem: "unfinished" }),
                None => found.push(Damage { run: String::new(), file, problem: "foreign" }),
            }
        }
        Ok(found)
    }

    /// Makes anew what follows from recordings that are whole, and removes what is left of others; gives how many runs were made whole.
    /// A damaged recording stays as it is.
    pub fn repair(&self, progress: Progress<'_>) -> Result<usize, StoreError> {
        let damaged: BTreeSet<String> =
            self.verify(progress)?.damages.into_iter().map(|damage| damage.run).filter(|run| !run.is_empty()).collect();
        let mut places: BTreeMap<String, Place> = BTreeMap::new();
        for file in self.list("")? {
            places.extend(
                Part::ALL.iter().find_map(|part| Place::parse(&file, *part)).map(|place| (place.run.clone(), place)),
            );
        }
        let mut whole = 0;
        for place in damaged.iter().filter_map(|run| places.get(run)) {
            match self.sum(&place.file(Part::Recording))? {
                Some(sum) if sum == place.run => {
                    self.remove_file(&place.file(Part::Run))?;
                    self.remove_file(&place.file(Part::Row))?;
                    // In a folder the recording is read where it lies, and found to be there.
                    let local = self.local(place)?;
                    whole += usize::from(self.add(local.path(), progress)?.is_new);
                }
                Some(_) => {}
                None if self.has(&place.file(Part::Run))? => {}
                None => self.remove(place)?,
            }
        }
        self.files.remove_unfinished().map_err(|error| self.access("an unfinished file", "removed", error))?;
        Ok(whole)
    }

    /// Removes a run with its recording and its results; from the beginning on it is no run any more.
    pub fn remove(&self, place: &Place) -> Result<(), StoreError> {
        let results = self.batches()?.into_iter().map(|batch| place.result(&batch));
        let files = Part::ALL.iter().rev().map(|part| place.file(*part));
        files.chain(results).try_for_each(|name| self.remove_file(&name))
    }

    /// Keeps what became of a run; where the batch has it already, this takes its place.
    pub fn keep(&self, batch: &str, place: &Place, outcome: &Outcome) -> Result<(), StoreError> {
        self.put(&place.result(checked(batch)?), format!("{}\n", outcome.json(place)).as_bytes())
    }

    /// Names of the runs that a batch has.
    pub fn kept(&self, batch: &str) -> Result<BTreeSet<String>, StoreError> {
        Ok(self.results_of(batch)?.into_iter().map(|(place, _)| place.run).collect())
    }

    /// The rows of a batch: `run`, `kind`, `software`, `given`, `code`, `error` and `result`, the last three null where they are not.
    pub fn results(&self, batch: &str) -> Result<Vec<Map<String, Value>>, StoreError> {
        let read = |(_, name): (Place, String)| match serde_json::from_slice(&self.bytes(&name)?) {
            Ok(Value::Object(values)) => Ok(values),
            _ => Err(self.damaged(&name, "it is no JSON object")),
        };
        self.results_of(batch)?.into_iter().map(read).collect()
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

    /// Places of all runs, in order.
    pub fn places(&self) -> Result<Vec<Place>, StoreError> {
        let names = self.list(Part::Run.folder())?;
        let mut places: Vec<Place> = names.iter().filter_map(|name| Place::parse(name, Part::Run)).collect();
        places.sort();
        Ok(places)
    }

    /// The sum of a file, where it is there.
    fn sum(&self, name: &str) -> Result<Option<String>, StoreError> {
        let mut sum = Sum::default();
        let read = self.files.read(name, &mut |part| {
            sum.take(part);
            Ok(())
        });
        match read {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            read => read.map(|()| Some(sum.hex())).map_err(|error| self.access(name, "read", error)),
        }
    }

    fn has(&self, name: &str) -> Result<bool, StoreError> {
        self.files.has(name).map_err(|error| self.access(name, "read", error))
    }

    fn bytes(&self, name: &str) -> Result<Vec<u8>, StoreError> {
        self.files.get(name).map_err(|error| self.access(name, "read", error))
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        let name = if folder.is_empty() { "it" } else { folder };
        self.files.list(folder).map_err(|error| self.access(name, "listed", error))
    }

    fn put(&self, name: &str, mut bytes: &[u8]) -> Result<(), StoreError> {
        self.files.put(name, &mut bytes).map_err(|error| self.access(name, "written", error))
    }

    fn remove_file(&self, name: &str) -> Result<(), StoreError> {
        self.files.remove(name).map_err(|error| self.access(name, "removed", error))
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
