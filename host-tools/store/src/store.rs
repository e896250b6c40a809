//! A store: runs go in, are found, checked and removed.

use std::{
    fs::File,
    io,
    path::{Path, PathBuf},
};

use inerter_data::{export::table_rows, output::Pending};
use serde_json::{Value, json};

use crate::{
    choice::Choice,
    error::StoreError,
    files::Files,
    folder::Folder,
    place::{Place, Table},
    row::Row,
    sums::{Expected, Sum, Summed, parse},
    tables::Tables,
};

/// Version of the layout and of the tables, which later versions read too. A column more is none; one less, or another meaning, is.
pub const VERSION: u64 = 1;

/// The file that makes a folder a store.
const MARK: &str = "inerter-store.json";

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

/// A file that is not as it was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// The run.
    pub run: String,
    /// The file, from the root of the store.
    pub file: String,
    /// `missing`, `changed` or `unfinished`: a run that was not added, or not removed, to its end.
    pub problem: &'static str,
}

/// Reads of the work that is done, from 0 to 1; an error ends it.
pub type Progress<'a> = &'a mut dyn FnMut(f64) -> Result<(), StoreError>;

impl Store {
    /// Opens a store that is there.
    pub fn open(url: &str) -> Result<Self, StoreError> {
        let store = Self::at(url)?;
        match store.version()? {
            Some(version) if version > VERSION => Err(StoreError::Newer { url: url.into(), version }),
            Some(_) => Ok(store),
            None => Err(StoreError::None { url: url.into() }),
        }
    }

    /// Opens a store, and makes it where nothing is yet.
    pub fn create(url: &str) -> Result<Self, StoreError> {
        let store = Self::at(url)?;
        match store.version()? {
            Some(version) if version > VERSION => Err(StoreError::Newer { url: url.into(), version }),
            Some(_) => Ok(store),
            None => {
                if !store.at_files("", "listed", |files| files.list(""))?.is_empty() {
                    return Err(StoreError::Foreign { url: url.into() });
                }
                let mark = format!("{}\n", json!({ "kind": "inerter-store", "version": VERSION }));
                store.put(MARK, mark.as_bytes())?;
                Ok(store)
            }
        }
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
            Some(("file", path)) => Box::new(Folder::new(PathBuf::from(path))),
            #[cfg(feature = "s3")]
            Some(("s3", bucket)) => Box::new(crate::s3::Bucket::new(bucket).map_err(|error| {
                refused(&error.to_string(), "set AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION or AWS_ENDPOINT")
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

    fn version(&self) -> Result<Option<u64>, StoreError> {
        if !self.at_files(MARK, "read", |files| files.has(MARK))? {
            return Ok(None);
        }
        let bytes = self.at_files(MARK, "read", |files| files.get(MARK))?;
        let mark: Value = serde_json::from_slice(&bytes).unwrap_or_default();
        let version = mark["version"].as_u64().filter(|_| mark["kind"] == "inerter-store");
        version.map(Some).ok_or_else(|| self.damaged(MARK, "it does not say which version it is"))
    }

    /// Adds a recording: the same one twice is one run. `progress` is handed the part that is done and may end the work, which
    /// leaves nothing that is counted as a run.
    pub fn add(&self, recording: &Path, progress: Progress<'_>) -> Result<Added, StoreError> {
        let unreadable = |source| inerter_data::recording::RecordingError::Read { path: recording.into(), source };
        let unreadable = |source| StoreError::from(inerter_data::Error::from(unreadable(source)));
        let open = || File::open(recording).map_err(unreadable);
        let mut before = Summed::new(open()?);
        io::copy(&mut before, &mut io::sink()).map_err(unreadable)?;
        let (length, run) = (before.length, before.sum.hex());
        if let Some(place) = self.places(Table::Runs)?.into_iter().find(|place| place.run == run) {
            return Ok(Added { row: self.row(&place)?, is_new: false });
        }
        let tables = Tables::of(recording, &run, progress)?;
        let place = &tables.place;
        let name = place.recording();
        let mut from = Expected::new(open()?, &run);
        let put = self.at_files(&name, "written", |files| files.put(&name, &mut from, length));
        put.map_err(|error| if from.is_other { StoreError::Changed { path: recording.into() } } else { error })?;
        for (table, bytes) in Table::ALL.into_iter().zip(&tables.bytes).take(3) {
            self.put(&place.table(table), bytes)?;
        }
        self.put(&place.sums(), tables.sums().as_bytes())?;
        // From here on it is there.
        let [.., runs] = &tables.bytes;
        self.put(&place.table(Table::Runs), runs)?;
        progress(1.0)?;
        Ok(Added { row: self.row(place)?, is_new: true })
    }

    /// The runs that are meant, by device, date and name.
    pub fn runs(&self, choice: &Choice) -> Result<Vec<Row>, StoreError> {
        let places = self.places(Table::Runs)?.into_iter().filter(|place| choice.may_be(place));
        let mut rows = Vec::new();
        for place in places {
            let row = self.row(&place)?;
            if choice.is(&row)? {
                rows.push(row);
            }
        }
        Ok(rows)
    }

    /// The run whose name begins like this.
    pub fn find(&self, beginning: &str) -> Result<Row, StoreError> {
        let run = beginning.to_lowercase();
        let found =
            self.places(Table::Runs)?.into_iter().filter(|place| place.run.starts_with(&run) && !run.is_empty());
        match found.collect::<Vec<_>>().as_slice() {
            [] => Err(StoreError::NoRun { url: self.url.clone(), run: beginning.into() }),
            [place] => self.row(place),
            all => Err(StoreError::Ambiguous { url: self.url.clone(), run: beginning.into(), count: all.len() }),
        }
    }

    /// The file with the recording of a run, where that is one of this computer.
    pub fn file(&self, row: &Row) -> Option<PathBuf> {
        self.files.file(&row.place.recording())
    }

    /// Writes the recording of a run into a file; only `replace` lets it take the place of one that is there.
    pub fn get(&self, row: &Row, file: &Path, replace: bool) -> Result<(), StoreError> {
        let name = row.place.recording();
        let pending = Pending::create(file, replace)?;
        let mut to = pending.open()?;
        let mut sum = Sum::default();
        self.at_files(&name, "read", |files| {
            files.read(&name, &mut |part| {
                sum.take(part);
                io::Write::write_all(&mut to, part)
            })
        })?;
        if sum.hex() != row.place.run {
            return Err(self.damaged(&name, "it is not what was added"));
        }
        pending.commit()?;
        Ok(())
    }

    /// Reads every file of every run, and lists what is not as it was written.
    pub fn verify(&self, progress: Progress<'_>) -> Result<Vec<Damage>, StoreError> {
        let whole = self.places(Table::Runs)?;
        let mut damages = Vec::new();
        for (number, place) in whole.iter().enumerate() {
            progress(number as f64 / whole.len() as f64)?;
            let damage = |file: &str, problem| Damage { run: place.run.clone(), file: file.into(), problem };
            let sums = place.sums();
            let expected = match self.at_files(&sums, "read", |files| files.has(&sums))? {
                true => parse(&String::from_utf8_lossy(&self.at_files(&sums, "read", |files| files.get(&sums))?)),
                false => Vec::new(),
            };
            let files = [place.recording()].into_iter().chain(Table::ALL.map(|table| place.table(table)));
            let names: Vec<String> = files.collect();
            if !expected.iter().map(|(name, _)| name).eq(&names) {
                damages.push(damage(&sums, if expected.is_empty() { "missing" } else { "changed" }));
            }
            for name in &names {
                if !self.at_files(name, "read", |files| files.has(name))? {
                    damages.push(damage(name, "missing"));
                    continue;
                }
                let mut sum = Sum::default();
                self.at_files(name, "read", |files| {
                    files.read(name, &mut |part| {
                        sum.take(part);
                        Ok(())
                    })
                })?;
                let wanted = match *name == place.recording() {
                    true => Some(&place.run),
                    false => expected.iter().find(|(file, _)| file == name).map(|(_, sum)| sum),
                };
                let sum = sum.hex();
                if wanted.is_some_and(|wanted| *wanted != sum) {
                    damages.push(damage(name, "changed"));
                }
            }
        }
        let mut unfinished = self.leftovers(&whole)?;
        damages.append(&mut unfinished);
        progress(1.0)?;
        Ok(damages)
    }

    /// Files of what is no run.
    fn leftovers(&self, whole: &[Place]) -> Result<Vec<Damage>, StoreError> {
        let tables = Table::ALL.map(Table::folder).into_iter().filter(|folder| *folder != Table::Runs.folder());
        let mut found = Vec::new();
        for folder in ["recordings", "sums"].into_iter().chain(tables) {
            for file in self.at_files(folder, "listed", |files| files.list(folder))? {
                let Some(place) = Place::parse(&file) else { continue };
                if whole.binary_search(&place).is_err() {
                    found.push(Damage { run: place.run, file, problem: "unfinished" });
                }
            }
        }
        Ok(found)
    }

    /// Removes a run with its recording; from the beginning on it is no run any more.
    pub fn remove(&self, row: &Row) -> Result<(), StoreError> {
        self.remove_files(&row.place)
    }

    fn remove_files(&self, place: &Place) -> Result<(), StoreError> {
        let tables = [Table::Runs, Table::Events, Table::Reversals, Table::Estimates].map(|table| place.table(table));
        for name in tables.into_iter().chain([place.sums(), place.recording()]) {
            self.at_files(&name, "removed", |files| files.remove(&name))?;
        }
        Ok(())
    }

    /// Removes what adding or removing left behind before its end; gives how many runs that were none.
    pub fn tidy(&self) -> Result<usize, StoreError> {
        let whole = self.places(Table::Runs)?;
        let mut places: Vec<Place> =
            self.leftovers(&whole)?.iter().filter_map(|damage| Place::parse(&damage.file)).collect();
        places.sort();
        places.dedup();
        places.iter().try_for_each(|place| self.remove_files(place))?;
        Ok(places.len())
    }

    /// Places that have a file in the folder of this table, in order.
    fn places(&self, table: Table) -> Result<Vec<Place>, StoreError> {
        let names = self.at_files(table.folder(), "listed", |files| files.list(table.folder()))?;
        let mut places: Vec<Place> = names.iter().filter_map(|name| Place::parse(name)).collect();
        places.sort();
        Ok(places)
    }

    fn row(&self, place: &Place) -> Result<Row, StoreError> {
        let name = place.table(Table::Runs);
        let bytes = self.at_files(&name, "read", |files| files.get(&name))?;
        let rows = table_rows(bytes).map_err(|error| self.damaged(&name, &error.to_string()))?;
        let [values] = <[_; 1]>::try_from(rows)
            .map_err(|rows| self.damaged(&name, &format!("it has {} rows instead of one", rows.len())))?;
        Ok(Row { place: place.clone(), values })
    }

    fn put(&self, name: &str, mut bytes: &[u8]) -> Result<(), StoreError> {
        let length = bytes.len() as u64;
        self.at_files(name, "written", |files| files.put(name, &mut bytes, length))
    }

    fn at_files<T>(
        &self,
        file: &str,
        action: &'static str,
        work: impl FnOnce(&dyn Files) -> io::Result<T>,
    ) -> Result<T, StoreError> {
        let failed = |source| StoreError::Access { url: self.url.clone(), file: file.into(), action, source };
        work(&*self.files).map_err(failed)
    }

    fn damaged(&self, file: &str, problem: &str) -> StoreError {
        StoreError::Damaged { url: self.url.clone(), file: file.into(), problem: problem.into() }
    }
}
