//! An input, consumed from its front.

/// The remaining bytes. Reads beyond the end give zero.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a>(pub &'a [u8]);

impl<'a> Input<'a> {
    /// Whether no bytes remain.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Up to this many bytes.
    pub fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        taken
    }

    /// All remaining bytes.
    pub fn rest(&mut self) -> &'a [u8] {
        self.take(usize::MAX)
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        let taken = self.take(N);
        bytes[..taken.len()].copy_from_slice(taken);
        bytes
    }

    /// One byte.
    pub fn byte(&mut self) -> u8 {
        u8::from_le_bytes(self.array())
    }

    /// Two bytes.
    pub fn half(&mut self) -> u16 {
        u16::from_le_bytes(self.array())
    }

    /// Four bytes.
    pub fn word(&mut self) -> u32 {
        u32::from_le_bytes(self.array())
    }

    /// A length (u16) and that many bytes, or fewer at the end.
    pub fn counted(&mut self) -> &'a [u8] {
        let count = self.half();
        self.take(count.into())
    }
}

/// An input of these bytes, one after the other.
pub fn seed(head: &[u8], rest: impl AsRef<[u8]>) -> Vec<u8> {
    [head, rest.as_ref()].concat()
}

/// Encodes bytes for [`Input::counted`].
pub fn counted(bytes: impl AsRef<[u8]>) -> Vec<u8> {
    let length = u16::try_from(bytes.as_ref().len()).unwrap_or(u16::MAX);
    seed(&length.to_le_bytes(), bytes)
}
