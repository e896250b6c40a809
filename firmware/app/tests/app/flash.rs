//! Flash whose power fails in the middle of an operation.
//!
//! 8 pages of 2 KB in double words of 8 bytes, like the last ones of an STM32G474. Each double word can be written once
//! after its page was erased (RM0440, programming sequence). After a power failure, a partly written one may read as
//! anything, give an error (`ECCD`), or look blank and still refuse to be written.

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use inerter_needs::Random;
use std::cell::{RefCell, RefMut};
use std::ops::Range;
use std::rc::Rc;

pub const PAGES: usize = 8;
pub const PAGE: usize = 2048;
pub const WORD: usize = 8;
pub const WORDS: usize = PAGES * PAGE / WORD;
/// A range that does not start at zero, as on the chip.
pub const RANGE: Range<u32> = 0x7_C000..0x8_0000;

/// A double word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    Blank,
    Written([u8; WORD]),
    /// Reads as these bytes; cannot be written.
    Worn([u8; WORD]),
    /// Reading gives an error.
    Unreadable,
}

impl Word {
    pub fn bytes(self) -> Option<[u8; WORD]> {
        match self {
            Self::Blank => Some([0xFF; WORD]),
            Self::Written(bytes) | Self::Worn(bytes) => Some(bytes),
            Self::Unreadable => None,
        }
    }
}

/// State in which a power failure leaves an operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// Not started.
    Undone,
    /// Reads as all ones, and cannot be written.
    Ones,
    /// Some of the bits that had to change have changed.
    Partly,
    /// Other bits have changed too.
    Garbage,
    Unreadable,
    /// Each double word of a page in a different state.
    Mixed,
    /// Complete, but the caller did not get the result.
    Done,
}

impl Left {
    pub const ALL: [Self; 7] =
        [Self::Undone, Self::Ones, Self::Partly, Self::Garbage, Self::Unreadable, Self::Mixed, Self::Done];
}

#[derive(Clone, Debug)]
pub struct Inner {
    pub words: Vec<Word>,
    pub erases: [u32; PAGES],
    pub writes: u32,
    pub reads: u32,
    /// Writes to words that were not blank, although no operation had failed.
    pub overwrites: u32,
    /// Number of words written and pages erased until the power fails, and the state of the interrupted operation.
    cut: Option<(u32, Left)>,
    powered: bool,
    noise: Random,
}

/// The flash. Clones share its content.
#[derive(Clone, Debug)]
pub struct Flash(Rc<RefCell<Inner>>);

impl Flash {
    pub fn blank() -> Self {
        Self::with(vec![Word::Blank; WORDS])
    }

    pub fn with(words: Vec<Word>) -> Self {
        assert_eq!(words.len(), WORDS);
        Self(Rc::new(RefCell::new(Inner {
            words,
            erases: [0; PAGES],
            writes: 0,
            reads: 0,
            overwrites: 0,
            cut: None,
            powered: true,
            noise: Random(1),
        })))
    }

    pub fn inner(&self) -> RefMut<'_, Inner> {
        self.0.borrow_mut()
    }

    /// Another flash with the same content.
    pub fn copy(&self) -> Self {
        Self::with(self.inner().words.clone())
    }

    /// Makes the power fail after this many operations.
    pub fn cut_after(&self, operations: u32, left: Left, seed: u64) {
        let mut inner = self.inner();
        inner.cut = Some((operations, left));
        inner.noise = Random(seed);
    }

    /// Restores the power. Returns whether it had failed.
    pub fn power_up(&self) -> bool {
        let mut inner = self.inner();
        inner.cut = None;
        !std::mem::replace(&mut inner.powered, true)
    }

    /// Words written and pages erased so far.
    pub fn operations(&self) -> u32 {
        let inner = self.inner();
        inner.writes + inner.erases.iter().sum::<u32>()
    }
}

/// A flash that can be read in smaller parts than it is written, as most can.
pub struct FinelyRead(pub Flash);

impl Inner {
    /// The fate of the next operation: `None` if the power is off, otherwise whether and how it is interrupted.
    fn power(&mut self) -> Option<Option<Left>> {
        if !self.powered {
            return None;
        }
        match &mut self.cut {
            Some((0, left)) => {
                self.powered = false;
                Some(Some(*left))
            }
            Some((operations, _)) => {
                *operations -= 1;
                Some(None)
            }
            None => Some(None),
        }
    }

    /// The state of a word that is interrupted on its way from `old` to `new`.
    fn left(&mut self, left: Left, old: Word, new: Word) -> Word {
        let Some(bytes) = old.bytes() else { return if left == Left::Done { new } else { old } };
        let target = new.bytes().unwrap_or([0; WORD]);
        let noise = self.noise.draw().to_le_bytes();
        match left {
            Left::Undone => old,
            Left::Ones => Word::Worn([0xFF; WORD]),
            Left::Partly => {
                Word::Worn(std::array::from_fn(|place| bytes[place] & noise[place] | target[place] & !noise[place]))
            }
            Left::Garbage => Word::Worn(noise),
            Left::Unreadable => Word::Unreadable,
            Left::Mixed => {
                let left = self.noise.pick(&Left::ALL);
                self.left(if left == Left::Mixed { Left::Partly } else { left }, old, new)
            }
            Left::Done => new,
        }
    }
}

fn place(address: u32) -> usize {
    assert!(RANGE.contains(&address), "{address:#x}");
    (address - RANGE.start) as usize
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = WORD;

    async fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        assert!(place(address).is_multiple_of(WORD) && into.len().is_multiple_of(WORD), "{address:#x}");
        let mut inner = self.inner();
        inner.reads += 1;
        if !inner.powered {
            return Err(NorFlashErrorKind::Other);
        }
        for (place, bytes) in (place(address) / WORD..).zip(into.chunks_mut(WORD)) {
            let word = inner.words[place].bytes().ok_or(NorFlashErrorKind::Other)?;
            bytes.copy_from_slice(&word);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        RANGE.end as usize
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        assert!(
            from < to && place(from).is_multiple_of(PAGE) && place(to - 1) % PAGE == PAGE - 1,
            "{from:#x}..{to:#x}"
        );
        let mut inner = self.inner();
        for page in place(from) / PAGE..=place(to - 1) / PAGE {
            let failing = inner.power().ok_or(NorFlashErrorKind::Other)?;
            for word in page * PAGE / WORD..(page + 1) * PAGE / WORD {
                let old = inner.words[word];
                inner.words[word] = inner.left(failing.unwrap_or(Left::Done), old, Word::Blank);
            }
            if failing.is_some() {
                return Err(NorFlashErrorKind::Other);
            }
            inner.erases[page] += 1;
        }
        Ok(())
    }

    async fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        assert!(place(address).is_multiple_of(WORD) && bytes.len().is_multiple_of(WORD), "{address:#x}");
        let mut inner = self.inner();
        for (word, bytes) in (place(address) / WORD..).zip(bytes.chunks(WORD)) {
            let failing = inner.power().ok_or(NorFlashErrorKind::Other)?;
            let old = inner.words[word];
            if old != Word::Blank {
                inner.overwrites += u32::from(matches!(old, Word::Written(_)));
                return Err(NorFlashErrorKind::Other);
            }
            inner.words[word] =
                inner.left(failing.unwrap_or(Left::Done), old, Word::Written(bytes.try_into().unwrap()));
            if failing.is_some() {
                return Err(NorFlashErrorKind::Other);
            }
            inner.writes += 1;
        }
        Ok(())
    }
}

impl ErrorType for FinelyRead {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for FinelyRead {
    const READ_SIZE: usize = WORD / 2;

    async fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.0.read(address, into).await
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for FinelyRead {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0.erase(from, to).await
    }

    async fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.0.write(address, bytes).await
    }
}
