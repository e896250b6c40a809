//! Settings that survive a restart, in flash.
//!
//! Terms:
//! - *entry*: one set of settings as stored in flash.
//! - *generation*: number of an entry. The newest intact one counts; a power failure falls back to the one before.
//! - *ring*: one half of the pages, filled cyclically by `sequential-storage`.
//!
//! ```text
//! entry = "inrt" ++ version (u8) ++ generation (u32) ++ length (u16) ++ settings (postcard, length bytes) ++ CRC-32
//! ```
//! Little-endian; the CRC is ISO-HDLC's, over everything before it. Head and CRC are the same in every version. An
//! entry of length 0 means in every version that nothing is saved.
//!
//! **Power failure** at any moment leaves the set before or the set that was being saved; a double word that was being
//! written, or a page that was being erased, may then hold anything, be unreadable, or look blank and refuse to be
//! written. One ring is in use. The page that holds the newest entry is never erased, and every entry is read back. If
//! anything fails in the ring in use, the other ring is erased and takes the entry. A factory reset works the same way:
//! an empty entry goes into the other ring first, so that no older one comes back.
//!
//! **Reading** goes over the pages word by word and depends on nothing but the entries themselves: `sequential-storage`
//! repairs while it reads, but data not understood here must stay unchanged until the user saves. It takes one read
//! per word and at most two per entry; whatever the flash holds, each word that begins like an entry costs no more than
//! one pass over its page.
//!
//! **Wear** with 25 settings, pages of 2 KB and rings of 4 pages, as on the STM32G474: 7 entries fit a page, so
//! every page of the ring is erased once in 28 saves (test `wear_is_as_stated`). The flash endures 10 000 erases of a
//! page (DS12288, flash memory endurance), hence 280 000 saves. Saving what was last saved writes nothing. The other
//! ring is erased at most once per power failure during a save, and once per factory reset.
//!
//! **The driver**: `read` returns an error for a word that the error correction cannot correct (STM32G4:
//! `FLASH_ECCR.ECCD` and an NMI, RM0440, error code correction of the flash), `write` for one that was not blank; both
//! must still work elsewhere. The store stays within its pages.

use crate::board::{Store, StoreError};
use core::ops::Range;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use inerter_wire::{Crc32, MAX_SETTINGS, SettingsValues};
use sequential_storage::cache::Cache;
use sequential_storage::map::{MapConfig, MapStorage, SerializationError, Value};

/// Format version of the settings in an entry. It changes only when an older firmware must not read them; settings
/// appended to the table do not change it.
const VERSION: u8 = 1;
const MAGIC: [u8; 4] = *b"inrt";
/// Magic, version, generation, length.
const HEAD: usize = 4 + 1 + 4 + 2;
const CHECKSUM: usize = 4;

/// Largest word that `sequential-storage` supports (bytes).
const GREATEST_WORD: usize = 32;
/// Longest entry of this version. The number of settings is one byte, each a number and an f64.
const LONGEST: usize = HEAD + 1 + MAX_SETTINGS * (1 + 8) + CHECKSUM;
/// Room for it, in whole words.
const BUFFER: usize = LONGEST.next_multiple_of(GREATEST_WORD);
const _: () = assert!(MAX_SETTINGS < 0x80, "the number of settings is one byte in postcard");

/// Pages that a ring needs: one in use, one blank ahead of it, one between, so that the newest entry is never in a page
/// that is due to be erased.
const RING_PAGES: u32 = 3;

/// Settings in dedicated flash pages.
pub struct FlashStore<F> {
    flash: F,
    range: Range<u32>,
    buffer: [u8; BUFFER],
    /// Something was saved since the start, so the newest entry was written completely.
    saved: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ring {
    First,
    Second,
}

impl Ring {
    fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    Settings,
    /// The settings were erased.
    Nothing,
    /// Settings in a form that this firmware does not know.
    Newer,
}

#[derive(Clone, Copy, Debug)]
struct Found {
    address: u32,
    generation: u32,
    content: Content,
}

/// The contents of the pages.
#[derive(Clone, Copy, Debug)]
struct Survey {
    newest: Option<Found>,
    /// Nothing was ever written to the ring since it was erased.
    first_blank: bool,
    second_blank: bool,
    /// At least one word could be read.
    readable: bool,
}

impl Survey {
    fn blank(&self, ring: Ring) -> bool {
        match ring {
            Ring::First => self.first_blank,
            Ring::Second => self.second_blank,
        }
    }
}

/// An entry to be written.
struct Entry<'a> {
    generation: u32,
    settings: Option<&'a SettingsValues>,
}

impl Entry<'_> {
    fn write(&self, into: &mut [u8]) -> Option<usize> {
        let (head, rest) = into.split_at_mut_checked(HEAD)?;
        let length = match self.settings {
            Some(settings) => postcard::to_slice(settings, rest).ok()?.len(),
            None => 0,
        };
        let fields = MAGIC
            .into_iter()
            .chain([VERSION])
            .chain(self.generation.to_le_bytes())
            .chain(u16::try_from(length).ok()?.to_le_bytes());
        for (place, byte) in head.iter_mut().zip(fields) {
            *place = byte;
        }
        let checksum = Crc32::of(into.get(..HEAD + length)?).to_le_bytes();
        into.get_mut(HEAD + length..)?.first_chunk_mut().map(|place| *place = checksum)?;
        Some(HEAD + length + CHECKSUM)
    }
}

impl<'v> Value<'v> for Entry<'_> {
    fn serialize_into(&self, buffer: &mut [u8]) -> Result<usize, SerializationError> {
        self.write(buffer).ok_or(SerializationError::BufferTooSmall)
    }

    fn deserialize_from(_buffer: &'v [u8]) -> Result<(Self, usize), SerializationError> {
        // Entries are read without `sequential-storage`.
        Err(SerializationError::InvalidFormat)
    }
}

/// Length of an entry with its CRC, version and generation.
fn parse_head(head: &[u8]) -> Option<(usize, u8, u32)> {
    let (magic, rest) = head.split_first_chunk::<4>()?;
    let (version, rest) = rest.split_first()?;
    let (generation, rest) = rest.split_first_chunk()?;
    let length = u16::from_le_bytes(*rest.first_chunk()?);
    let total = HEAD + usize::from(length) + CHECKSUM;
    (*magic == MAGIC).then_some((total, *version, u32::from_le_bytes(*generation)))
}

/// The settings of an intact entry.
fn parse_settings(entry: &[u8]) -> Option<SettingsValues> {
    match postcard::take_from_bytes(entry.get(HEAD..entry.len().checked_sub(CHECKSUM)?)?) {
        Ok((settings, [])) => Some(settings),
        _ => None,
    }
}

impl<F: NorFlash> FlashStore<F> {
    /// Bytes that are read and written together.
    const WORD: usize = {
        let word = if F::WRITE_SIZE > F::READ_SIZE { F::WRITE_SIZE } else { F::READ_SIZE };
        assert!(word >= MAGIC.len() && word <= GREATEST_WORD, "words of 4 to 32 bytes");
        word
    };

    /// A store in the pages of `range`, in the addresses of `flash`. Nothing is read yet.
    ///
    /// Panics if `range` is not at least 6 whole pages, which is a programming error.
    pub const fn new(flash: F, range: Range<u32>) -> Self {
        let page = F::ERASE_SIZE as u32;
        assert!(range.start.is_multiple_of(page) && range.end.is_multiple_of(page), "whole pages");
        assert!(range.start < range.end && (range.end - range.start) / page >= 2 * RING_PAGES, "at least 6 pages");
        Self { flash, range, buffer: [0; BUFFER], saved: false }
    }

    fn pages(&self, ring: Ring) -> Range<u32> {
        let page = F::ERASE_SIZE as u32;
        let middle = self.range.start + (self.range.end - self.range.start) / page / 2 * page;
        match ring {
            Ring::First => self.range.start..middle,
            Ring::Second => middle..self.range.end,
        }
    }

    fn ring_of(&self, found: Found) -> Ring {
        if self.pages(Ring::First).contains(&found.address) { Ring::First } else { Ring::Second }
    }

    /// Reads every word; writes nothing.
    async fn survey(&mut self) -> Survey {
        let mut survey = Survey { newest: None, first_blank: true, second_blank: true, readable: false };
        let middle = self.pages(Ring::First).end;
        for address in self.range.clone().step_by(Self::WORD) {
            let mut buffer = [0; GREATEST_WORD];
            let word = buffer.get_mut(..Self::WORD).unwrap_or_default();
            let read = self.flash.read(address, word).await.is_ok();
            survey.readable |= read;
            let blank = read && word.iter().all(|&byte| byte == 0xFF);
            if address < middle {
                survey.first_blank &= blank;
            } else {
                survey.second_blank &= blank;
            }
            if read && word.starts_with(&MAGIC) {
                let newer = self.entry(address, survey.newest).await;
                survey.newest = newer.or(survey.newest);
            }
        }
        survey
    }

    /// The intact entry at `address`, if it is newer than `than`. If it fits, it is then in the buffer.
    async fn entry(&mut self, address: u32, than: Option<Found>) -> Option<Found> {
        // Pages begin at multiples of their size, as the range does.
        let left = F::ERASE_SIZE - address as usize % F::ERASE_SIZE;
        let head = self.buffer.get_mut(..HEAD.next_multiple_of(Self::WORD).min(left))?;
        self.flash.read(address, head).await.ok()?;
        let (total, version, generation) = parse_head(head)?;
        if total > left || than.is_some_and(|than| than.generation >= generation) {
            return None;
        }
        let mut digest = Crc32::new();
        for start in (0..total).step_by(BUFFER) {
            let length = (total - start).min(BUFFER);
            let part = self.buffer.get_mut(..length.next_multiple_of(Self::WORD))?;
            self.flash.read(address + start as u32, part).await.ok()?;
            digest.update(part.get(..length)?);
        }
        if digest.value() != Crc32::OF_INTACT {
            return None;
        }
        let content = if total == HEAD + CHECKSUM {
            Content::Nothing
        } else if version > VERSION {
            Content::Newer
        } else if version == VERSION && self.buffer.get(..total).and_then(parse_settings).is_some() {
            Content::Settings
        } else {
            return None;
        };
        Some(Found { address, generation, content })
    }

    /// The settings of an entry that was found.
    async fn settings(&mut self, found: Found) -> Option<SettingsValues> {
        self.entry(found.address, None).await?;
        let (total, ..) = parse_head(&self.buffer)?;
        self.buffer.get(..total).and_then(parse_settings)
    }

    /// Makes `settings`, or nothing, the newest entry: in the first of `rings` or, if that fails, in the second.
    async fn put(
        &mut self,
        survey: &Survey,
        settings: Option<&SettingsValues>,
        rings: [Ring; 2],
    ) -> Result<(), StoreError> {
        let next = survey.newest.map_or(Some(0), |newest| newest.generation.checked_add(1));
        let generation = next.ok_or(StoreError::Unreadable)?;
        let entry = Entry { generation, settings };
        let [first, second] = rings;
        // A page that looks blank may still refuse to be written.
        for (ring, blank) in [(first, survey.blank(first)), (second, false)] {
            let pages = self.pages(ring);
            let newest = survey.newest.map(|newest| newest.address).filter(|address| pages.contains(address));
            if newest.is_some() || blank || self.erase_ring(ring).await.is_ok() {
                self.append(ring, &entry, newest).await;
            }
            if self.survey().await.newest.is_some_and(|newest| newest.generation == generation) {
                return Ok(());
            }
        }
        Err(StoreError::Unreadable)
    }

    /// Tries to write an entry. The caller must read the flash to find out whether it succeeded.
    async fn append(&mut self, ring: Ring, entry: &Entry<'_>, newest: Option<u32>) {
        let pages = self.pages(ring);
        let flash = Guarded { flash: &mut self.flash, keep: newest };
        let Ok(config) = MapConfig::try_new(pages) else { return };
        let mut map = MapStorage::<(), _, _>::new(flash, config, Cache::new_uncached());
        let _ = map.store_item(&mut self.buffer, &(), entry).await;
    }

    async fn erase_ring(&mut self, ring: Ring) -> Result<(), StoreError> {
        let pages = self.pages(ring);
        self.flash.erase(pages.start, pages.end).await.map_err(|_| StoreError::Unreadable)
    }
}

impl<F: NorFlash> Store for FlashStore<F> {
    /// [`StoreError::Foreign`] also after a first save that was cut short by a power failure: there is no older entry.
    async fn load(&mut self) -> Result<Option<SettingsValues>, StoreError> {
        let survey = self.survey().await;
        match survey.newest {
            Some(found) => match found.content {
                Content::Settings => self.settings(found).await.map(Some).ok_or(StoreError::Unreadable),
                Content::Nothing => Ok(None),
                Content::Newer => Err(StoreError::Newer),
            },
            None if !survey.readable => Err(StoreError::Unreadable),
            None if survey.first_blank && survey.second_blank => Ok(None),
            None => Err(StoreError::Foreign),
        }
    }

    /// Refused while no word can be read: the data may be good, and only [`erase`](Store::erase) may destroy it.
    async fn save(&mut self, settings: &SettingsValues) -> Result<(), StoreError> {
        let survey = self.survey().await;
        if !survey.readable {
            return Err(StoreError::Unreadable);
        }
        let home = survey.newest.map_or(Ring::First, |newest| self.ring_of(newest));
        if let Some(newest) = survey.newest
            && self.saved
            && newest.content == Content::Settings
            && self.settings(newest).await.as_ref() == Some(settings)
        {
            return Ok(());
        }
        self.put(&survey, Some(settings), [home, home.other()]).await?;
        self.saved = true;
        Ok(())
    }

    async fn erase(&mut self) -> Result<(), StoreError> {
        let survey = self.survey().await;
        let home = survey.newest.map_or(Ring::First, |newest| self.ring_of(newest));
        let other = home.other();
        if let Some(newest) = survey.newest {
            if newest.content == Content::Nothing && survey.blank(other) {
                return Ok(());
            }
            if self.put(&survey, None, [other; 2]).await.is_ok() {
                return self.erase_ring(home).await;
            }
        } else if survey.first_blank && survey.second_blank {
            return Ok(());
        }
        self.erase_ring(other).await?;
        self.erase_ring(home).await
    }
}

/// The flash as `sequential-storage` sees it: the page of the newest entry is never erased, not even for a repair.
struct Guarded<'a, F> {
    flash: &'a mut F,
    keep: Option<u32>,
}

impl<F: NorFlash> ErrorType for Guarded<'_, F> {
    type Error = NorFlashErrorKind;
}

impl<F: NorFlash> ReadNorFlash for Guarded<'_, F> {
    const READ_SIZE: usize = FlashStore::<F>::WORD;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.flash.read(offset, bytes).await.map_err(|error| error.kind())
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<F: NorFlash> NorFlash for Guarded<'_, F> {
    const WRITE_SIZE: usize = FlashStore::<F>::WORD;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        if self.keep.is_some_and(|address| (from..to).contains(&address)) {
            return Err(NorFlashErrorKind::Other);
        }
        self.flash.erase(from, to).await.map_err(|error| error.kind())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.flash.write(offset, bytes).await.map_err(|error| error.kind())
    }
}

#[cfg(test)]
mod tests {
    use super::{BUFFER, Entry, LONGEST};
    use inerter_wire::{MAX_SETTINGS, SettingValue, SettingsValues};

    #[test]
    fn the_longest_entry_is_as_long_as_stated() {
        let value = |number| SettingValue { number, value: f64::MAX };
        let settings = SettingsValues((0..MAX_SETTINGS as u8).map(value).collect());
        let entry = Entry { generation: u32::MAX, settings: Some(&settings) };
        assert_eq!(entry.write(&mut [0; BUFFER]), Some(LONGEST));
    }
}
