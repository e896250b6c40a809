//! The settings store on flash that loses its power, wears out, or has arbitrary content.

use crate::flash::{FinelyRead, Flash, Left, PAGE, PAGES, RANGE, WORD, WORDS, Word};
use embassy_futures::block_on;
use inerter_app::{FlashStore, Store, StoreError};
use inerter_core::Settings;
use inerter_needs::Random;
use inerter_wire::{MAX_SETTINGS, SettingValue, SettingsValues};
use proptest::prelude::*;
use sequential_storage::cache::Cache;
use sequential_storage::map::{MapConfig, MapStorage};

/// Settings that differ for every number; as many as the store can hold.
fn settings(number: u32) -> SettingsValues {
    sized(number, MAX_SETTINGS)
}

fn sized(number: u32, count: usize) -> SettingsValues {
    SettingsValues(
        (0..count as u8)
            .map(|place| SettingValue { number: place, value: f64::from(number) + f64::from(place) / 64.0 })
            .collect(),
    )
}

/// The store of a device that starts with this flash.
fn store(flash: &Flash) -> FlashStore<Flash> {
    FlashStore::new(flash.clone(), RANGE)
}

fn save(flash: &Flash, settings: &SettingsValues) -> Result<(), StoreError> {
    block_on(store(flash).save(settings))
}

fn erase(flash: &Flash) -> Result<(), StoreError> {
    block_on(store(flash).erase())
}

/// The settings found at a start, which must not write.
fn load(flash: &Flash) -> Result<Option<SettingsValues>, StoreError> {
    let (before, reads) = (flash.operations(), flash.inner().reads);
    let loaded = block_on(store(flash).load());
    assert_eq!(flash.operations(), before, "loading wrote");
    // One read per word; a header and the entry per entry; the newest entry once more.
    let reads = flash.inner().reads - reads;
    assert!((reads as usize) <= 2 * WORDS, "{reads} reads");
    loaded
}

/// A flash after this many saves.
fn used(saves: u32) -> Flash {
    let flash = Flash::blank();
    for number in 1..=saves {
        save(&flash, &settings(number)).unwrap();
    }
    flash
}

/// Number of saves until every page of the ring has been erased: 4 entries of 48 settings per page, 4 pages, one of
/// them kept blank.
const ROUNDS: u32 = 6 * 4 + 3;

/// Words of a ring that holds an empty entry and no settings: the entry, and what `sequential-storage` adds.
const EMPTY_ENTRY: usize = 4;

/// Writes bytes to the flash without the store, as another program would.
fn plant(flash: &Flash, word: usize, bytes: &[u8]) {
    for (word, bytes) in (word..).zip(bytes.chunks(WORD)) {
        let mut padded = [0; WORD];
        padded[..bytes.len()].copy_from_slice(bytes);
        flash.inner().words[word] = Word::Written(padded);
    }
}

/// An entry of another version.
fn entry(version: u8, generation: u32, content: &[u8]) -> Vec<u8> {
    let mut entry = b"inrt".to_vec();
    entry.push(version);
    entry.extend(generation.to_le_bytes());
    entry.extend((content.len() as u16).to_le_bytes());
    entry.extend(content);
    entry.extend(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&entry).to_le_bytes());
    entry
}

#[test]
fn what_was_saved_is_loaded() {
    let flash = Flash::blank();
    assert_eq!(load(&flash), Ok(None));
    for number in 1..=200 {
        let saved = sized(number, number as usize % (MAX_SETTINGS + 1));
        save(&flash, &saved).unwrap();
        assert_eq!(load(&flash), Ok(Some(saved)), "save {number}");
    }
    assert_eq!(flash.inner().overwrites, 0);
}

/// Used like a task that borrows its store.
#[test]
fn a_borrowed_store_does_what_its_own_does() {
    async fn all(mut store: impl Store) -> [Option<SettingsValues>; 2] {
        store.save(&settings(2)).await.unwrap();
        let saved = store.load().await.unwrap();
        store.erase().await.unwrap();
        [saved, store.load().await.unwrap()]
    }
    let flash = used(1);
    assert_eq!(block_on(all(&mut store(&flash))), [Some(settings(2)), None]);
    assert_eq!(load(&flash), Ok(None));
}

/// The flash asserts that it is read in whole double words.
#[test]
fn flash_is_read_in_the_words_in_which_it_is_written() {
    let flash = Flash::blank();
    let mut store = FlashStore::new(FinelyRead(flash.clone()), RANGE);
    block_on(store.save(&settings(1))).unwrap();
    assert_eq!(block_on(store.load()), Ok(Some(settings(1))));
    assert_eq!(load(&flash), Ok(Some(settings(1))));
}

#[test]
fn one_store_saves_again_and_again() {
    let flash = Flash::blank();
    let mut store = store(&flash);
    for number in 1..=100 {
        block_on(store.save(&settings(number))).unwrap();
        assert_eq!(block_on(store.load()), Ok(Some(settings(number))));
    }
}

#[test]
fn saving_the_same_again_writes_nothing() {
    let flash = used(3);
    let mut store = store(&flash);
    // The first save after a start always writes: the entry in flash may just have survived a power failure.
    let before = flash.operations();
    block_on(store.save(&settings(3))).unwrap();
    let operations = flash.operations();
    assert!(operations > before);
    for _ in 0..10 {
        block_on(store.save(&settings(3))).unwrap();
    }
    assert_eq!(flash.operations(), operations);
    block_on(store.save(&settings(4))).unwrap();
    assert!(flash.operations() > operations);
}

/// Interrupts every operation of `act` on a copy of `before` in every way. `check` gets the flash with the power
/// restored.
fn cut_everywhere(
    before: &Flash,
    act: impl Fn(&Flash) -> Result<(), StoreError>,
    mut check: impl FnMut(&Flash, &str),
) -> u32 {
    let whole = before.copy();
    act(&whole).unwrap();
    let operations = whole.operations();
    for operation in 0..operations {
        for (seed, left) in (0..).zip(Left::ALL) {
            let flash = before.copy();
            flash.cut_after(operation, left, u64::from(operation) * 7 + seed);
            let _ = act(&flash);
            assert!(flash.power_up(), "the power did not fail");
            assert_eq!(flash.inner().overwrites, 0);
            check(&flash, &format!("cut at operation {operation} of {operations}, left {left:?}"));
        }
    }
    operations
}

/// The store accepts this set and loads it.
#[track_caller]
fn assert_keeps(flash: &Flash, number: u32, cut: &str) {
    assert_eq!(save(flash, &settings(number)), Ok(()), "{cut}");
    assert_eq!(load(flash), Ok(Some(settings(number))), "{cut}");
}

/// The store accepts further sets and loads each of them.
fn assert_usable(flash: &Flash, cut: &str) {
    (1_000..1_002).for_each(|number| assert_keeps(flash, number, cut));
}

/// Number of words that hold something.
fn held(flash: &Flash) -> usize {
    flash.inner().words.iter().filter(|word| word.bytes() != Some([0xFF; WORD])).count()
}

/// The store forgets everything.
#[track_caller]
fn assert_forgets(flash: &Flash, cut: &str) {
    assert_eq!(erase(flash), Ok(()), "{cut}");
    assert_eq!(load(flash), Ok(None), "{cut}");
}

#[test]
fn power_failure_anywhere_leaves_the_old_set_or_the_new_one() {
    let flash = Flash::blank();
    let mut greatest = 0;
    for number in 0..ROUNDS {
        let (old, new) = (load(&flash), Ok(Some(settings(number + 1))));
        let operations = cut_everywhere(
            &flash,
            |flash| save(flash, &settings(number + 1)),
            |flash, cut| {
                let loaded = load(flash);
                // Before the first set there is nothing older, and a part of it is foreign data.
                let lost = number == 0 && loaded == Err(StoreError::Foreign);
                assert!(loaded == old || loaded == new || lost, "save {number}: {cut}: {loaded:?}");
                assert_usable(flash, cut);
            },
        );
        greatest = greatest.max(operations);
        save(&flash, &settings(number + 1)).unwrap();
    }
    // The end of a page, the start of a page, an erase, 1 + 56 words: the interrupted operations include the page
    // change.
    assert_eq!(greatest, 60);
    let erases = flash.inner().erases;
    assert!(erases[..4].iter().all(|&erases| erases >= 1), "{erases:?}");
}

#[test]
fn power_may_fail_again_while_the_store_recovers() {
    // In the middle of a page; at the end of a page with blank pages ahead; at the end of a page with a page to erase.
    for saves in [2, 4, 12, 16, 28] {
        let flash = used(saves);
        let (old, new, next) = (settings(saves), settings(saves + 1), settings(saves + 2));
        let mut second = 0;
        cut_everywhere(
            &flash,
            |flash| save(flash, &new),
            |flash, cut| {
                let first = load(flash).unwrap().unwrap();
                assert!(first == old || first == new, "{saves}: {cut}");
                let whole = flash.copy();
                save(&whole, &next).unwrap();
                let operations = whole.operations();
                for operation in (0..operations).filter(|operation| operation % 5 == saves % 5 || operations < 12) {
                    let flash = flash.copy();
                    let left = Left::ALL[operation as usize / 5 % Left::ALL.len()];
                    flash.cut_after(operation, left, u64::from(operation));
                    let _ = save(&flash, &next);
                    assert!(flash.power_up());
                    let loaded = load(&flash).unwrap().unwrap();
                    let again = format!("{saves}: {cut}, again at {operation}, left {left:?}");
                    assert!(loaded == first || loaded == next, "{again}");
                    assert_keeps(&flash, 7, &again);
                    second += 1;
                }
            },
        );
        assert!(second > 1_000, "{second}");
    }
}

#[test]
fn power_failing_always_loses_nothing() {
    let flash = used(5);
    let mut noise = Random(99);
    let mut kept = settings(5);
    for number in 6..3_000 {
        let left = noise.pick(&Left::ALL);
        flash.cut_after(noise.below(70), left, noise.draw());
        let (saved, new) = (save(&flash, &settings(number)), settings(number));
        let failed = flash.power_up();
        let loaded = load(&flash).unwrap().unwrap();
        assert!(loaded == new || (failed && loaded == kept), "save {number}");
        assert!(failed || saved == Ok(()), "save {number}");
        kept = loaded;
    }
}

#[test]
fn a_factory_reset_forgets() {
    for saves in [0, 1, 5, ROUNDS] {
        let flash = used(saves);
        assert_forgets(&flash, "");
        let operations = flash.operations();
        erase(&flash).unwrap();
        assert_eq!(flash.operations(), operations, "once is enough");
        assert!(held(&flash) <= EMPTY_ENTRY, "{} words", held(&flash));
        assert_usable(&flash, "");
        assert_forgets(&flash, "");
    }
}

#[test]
fn power_failure_in_a_factory_reset_leaves_the_old_set_or_none() {
    for saves in [1, 2, 7, ROUNDS] {
        let flash = used(saves);
        let old = Ok(Some(settings(saves)));
        cut_everywhere(&flash, erase, |flash, cut| {
            let loaded = load(flash);
            assert!(loaded == old || loaded == Ok(None), "{saves}: {cut}: {loaded:?}");
            let again = flash.copy();
            assert_forgets(&again, cut);
            assert!(held(&again) <= EMPTY_ENTRY, "{saves}: {cut}: {} words", held(&again));
            assert_usable(&again, cut);
            assert_usable(flash, cut);
        });
    }
}

#[test]
fn a_newer_firmwares_settings_are_kept_until_others_are_saved() {
    for length in [1, 20, 600, 1_500] {
        let flash = used(2);
        // In the page after those in use, where a newer firmware may have its entries.
        plant(&flash, PAGE / WORD, &[0; 8]);
        plant(&flash, PAGE / WORD + 2, &entry(2, 77, &vec![0x5A; length]));
        assert_eq!(load(&flash), Err(StoreError::Newer));
        cut_everywhere(
            &flash,
            |flash| save(flash, &settings(9)),
            |flash, cut| {
                let loaded = load(flash);
                assert!(
                    loaded == Err(StoreError::Newer) || loaded == Ok(Some(settings(9))),
                    "{length}: {cut}: {loaded:?}"
                );
                assert_usable(flash, cut);
            },
        );
        let other = flash.copy();
        assert_forgets(&other, "");
    }
    let flash = Flash::blank();
    plant(&flash, 2, &entry(9, 77, &[]));
    assert_eq!(load(&flash), Ok(None), "forgotten, in every version");
}

#[test]
fn a_damaged_set_gives_way_to_the_one_before() {
    let flash = used(3);
    let words = flash.inner().words.clone();
    let last = words.iter().rposition(|word| matches!(word, Word::Written(_))).unwrap();
    for word in last - 56..=last {
        for damage in [Word::Unreadable, Word::Worn([0xFF; WORD]), Word::Worn([0; WORD])] {
            let flash = flash.copy();
            flash.inner().words[word] = damage;
            let loaded = load(&flash);
            // The reader ignores the entry's header, which only sequential-storage uses.
            let expected = if word == last - 56 { settings(3) } else { settings(2) };
            assert_eq!(loaded, Ok(Some(expected)), "word {word} as {damage:?}");
            assert_usable(&flash, "");
        }
    }
}

#[test]
fn what_is_not_ours_is_foreign_and_kept_until_the_user_saves() {
    let mut noise = Random(5);
    let mut random = || Word::Written(noise.draw().to_le_bytes());
    let images: Vec<Vec<Word>> = vec![
        (0..WORDS).map(|_| random()).collect(),
        vec![Word::Written([0; WORD]); WORDS],
        vec![Word::Written([0xFE; WORD]); WORDS],
        (0..WORDS).map(|word| if word % 256 == 0 { Word::Written([0; WORD]) } else { Word::Blank }).collect(),
        (0..WORDS).map(|word| if word == 999 { Word::Unreadable } else { Word::Blank }).collect(),
        (0..WORDS).map(|word| if word == WORDS - 1 { Word::Written([0; WORD]) } else { Word::Blank }).collect(),
    ];
    for (number, image) in images.into_iter().enumerate() {
        let flash = Flash::with(image.clone());
        assert_eq!(load(&flash), Err(StoreError::Foreign), "image {number}");
        assert_eq!(flash.inner().words, image, "image {number}");
        let other = flash.copy();
        assert_usable(&flash, "");
        assert_forgets(&other, &format!("image {number}"));
        assert_usable(&other, "");
    }
    // Entries that are ours by the checksum alone.
    for foreign in [entry(0, 1, &[0]), entry(1, 1, &[1]), entry(1, 1, &[1, 0, 0]), entry(1, 1, &[49; 500])] {
        let flash = Flash::blank();
        plant(&flash, 2, &foreign);
        assert_eq!(load(&flash), Err(StoreError::Foreign), "{foreign:?}");
        assert_usable(&flash, "");
    }
    let flash = Flash::blank();
    plant(&flash, 1020, &entry(2, 1, &[0; 40]));
    assert_eq!(load(&flash), Err(StoreError::Foreign), "an entry that does not end in its page");
}

#[test]
fn an_entry_may_fill_its_page_to_the_last_byte() {
    let flash = Flash::blank();
    let exact = entry(1, 1, &[0]);
    assert_eq!(exact.len(), 2 * WORD);
    plant(&flash, PAGE / WORD - 2, &exact);
    assert_eq!(load(&flash), Ok(Some(SettingsValues::default())));
}

#[test]
fn flash_that_cannot_be_read_at_all_is_left_alone() {
    let flash = Flash::with(vec![Word::Unreadable; WORDS]);
    assert_eq!(load(&flash), Err(StoreError::Unreadable));
    assert_eq!(save(&flash, &settings(1)), Err(StoreError::Unreadable));
    assert_eq!(flash.operations(), 0);
    assert_forgets(&flash, "");
    assert_usable(&flash, "");
}

#[test]
fn the_last_generation_is_the_end_until_a_factory_reset() {
    let flash = Flash::blank();
    plant(&flash, 2, &entry(1, u32::MAX, &[0]));
    assert_eq!(load(&flash), Ok(Some(SettingsValues::default())));
    assert_eq!(save(&flash, &settings(1)), Err(StoreError::Unreadable));
    assert_eq!(load(&flash), Ok(Some(SettingsValues::default())));
    erase(&flash).unwrap();
    assert_usable(&flash, "");
}

#[test]
fn wear_is_as_stated() {
    let flash = Flash::blank();
    let saves = 28 * 50;
    for number in 0..saves {
        let settings = Settings { memory_s: f64::from(number), ..Settings::default() };
        save(&flash, &SettingsValues::from(&settings)).unwrap();
    }
    let erases = flash.inner().erases;
    for (page, &erases) in erases.iter().enumerate() {
        let expected = if page < PAGES / 2 { saves / 28 } else { 0 };
        assert!(erases.abs_diff(expected) <= 1, "page {page}: {erases} erases in {saves} saves");
    }
}

#[test]
fn memory_is_as_small_as_it_should_be() {
    let flash = Flash::blank();
    let mut store = store(&flash);
    assert!(size_of_val(&store) <= 520, "store {} bytes", size_of_val(&store));
    let saved = settings(1);
    let load = size_of_val(&store.load());
    let save = size_of_val(&store.save(&saved));
    let erase = size_of_val(&store.erase());
    assert!(load.max(save).max(erase) <= 3_000, "futures of {load}, {save} and {erase} bytes");
}

/// Maps that other programs wrote with the same crate, including one whose items do not fit our buffer.
fn foreign_map(kind: u8, flash: &Flash) {
    let mut buffer = [0; 2_048];
    let range = if kind & 1 == 0 { RANGE } else { RANGE.start..RANGE.start + (PAGE * PAGES / 2) as u32 };
    let config = MapConfig::new(range);
    block_on(async {
        let fill = vec![kind; usize::from(kind) * 7];
        if kind & 2 == 0 {
            let mut map = MapStorage::<u32, _, _>::new(flash.clone(), config, Cache::new_uncached());
            for number in 0..u32::from(kind) {
                let _ = map.store_item(&mut buffer, &(number % 5), &fill.as_slice()).await;
            }
        } else {
            let mut map = MapStorage::<(), _, _>::new(flash.clone(), config, Cache::new_uncached());
            for _ in 0..kind {
                let _ = map.store_item(&mut buffer, &(), &fill.as_slice()).await;
            }
        }
    });
}

/// A modification of an image.
#[derive(Clone, Debug)]
enum Change {
    /// Flips a bit.
    Flip {
        word: usize,
        bit: usize,
    },
    Unreadable {
        word: usize,
    },
    Worn {
        word: usize,
    },
    Random {
        word: usize,
        length: usize,
        seed: u64,
    },
    Erased {
        page: usize,
    },
    /// Copies a page over another one.
    Copied {
        from: usize,
        to: usize,
    },
    Entry {
        word: usize,
        version: u8,
        generation: u32,
        length: usize,
    },
}

fn change() -> impl Strategy<Value = Change> {
    let word = || prop_oneof![0..WORDS, (0..WORDS / 32).prop_map(|place| place * 32), 0..80usize];
    prop_oneof![
        4 => (word(), 0..64usize).prop_map(|(word, bit)| Change::Flip { word, bit }),
        2 => word().prop_map(|word| Change::Unreadable { word }),
        2 => word().prop_map(|word| Change::Worn { word }),
        1 => (word(), 1..300usize, any::<u64>()).prop_map(|(word, length, seed)| Change::Random { word, length, seed }),
        1 => (0..PAGES).prop_map(|page| Change::Erased { page }),
        1 => (0..PAGES, 0..PAGES).prop_map(|(from, to)| Change::Copied { from, to }),
        1 => (word(), 0..4u8, 0..1_000u32, 0..1_000usize)
            .prop_map(|(word, version, generation, length)| Change::Entry { word, version, generation, length }),
    ]
}

impl Change {
    fn make(&self, flash: &Flash) {
        let words = PAGE / WORD;
        if let Self::Entry { word, version, generation, length } = *self {
            let entry = entry(version, generation, &vec![0; length]);
            let room = (WORDS - word) * WORD;
            return plant(flash, word, &entry[..entry.len().min(room)]);
        }
        let all = &mut flash.inner().words;
        match *self {
            Self::Flip { word, bit } => {
                let mut bytes = all[word].bytes().unwrap_or_default();
                bytes[bit / 8] ^= 1 << (bit % 8);
                all[word] = Word::Written(bytes);
            }
            Self::Unreadable { word } => all[word] = Word::Unreadable,
            Self::Worn { word } => all[word] = Word::Worn([0xFF; WORD]),
            Self::Random { word, length, seed } => {
                let mut noise = Random(seed);
                all.iter_mut()
                    .skip(word)
                    .take(length)
                    .for_each(|word| *word = Word::Written(noise.draw().to_le_bytes()));
            }
            Self::Erased { page } => all[page * words..(page + 1) * words].fill(Word::Blank),
            Self::Copied { from, to } => all.copy_within(from * words..(from + 1) * words, to * words),
            Self::Entry { .. } => {}
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]

    /// For any content of the flash: loading does not panic, write or run forever, and saving repairs the store.
    #[test]
    fn any_content_is_survived(
        saves in 0..40u32,
        foreign in prop_oneof![3 => Just(0u8), 1 => any::<u8>()],
        changes in prop::collection::vec(change(), 0..12),
        reset in any::<bool>(),
    ) {
        let flash = if foreign > 0 { Flash::blank() } else { used(saves) };
        if foreign > 0 {
            foreign_map(foreign, &flash);
        }
        for change in &changes {
            change.make(&flash);
        }
        let flash = flash.copy();
        let loaded = load(&flash);
        if foreign == 0 && changes.is_empty() {
            prop_assert_eq!(loaded, Ok((saves > 0).then(|| settings(saves))));
        }
        if reset {
            assert_forgets(&flash, "");
        }
        assert_usable(&flash, "");
    }
}
