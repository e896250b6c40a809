//! The host's side of the protocol with the instrument, independent of the transport.
//!
//! Bytes go in and out; the caller transfers them and keeps the time. The format is that of `docs/PROTOCOL.md`, encoded
//! and decoded by `inerter-wire`.

use inerter_wire::{
    Command, Counts, DELIMITER, Frame, FrameReader, MAX_FRAME, Record, Reply, Request, SequenceCounter, encode_request,
};
use std::collections::VecDeque;

/// Encodes requests and decodes records. By default at the start of both streams.
#[derive(Default)]
pub struct Talk {
    reader: FrameReader<Record>,
    sequence: SequenceCounter,
    last_id: u16,
    records: VecDeque<Record>,
    /// Frames that are missing according to the device's sequence numbers.
    pub lost: u64,
}

impl Talk {
    /// Encodes a request; returns its id, which the reply carries, and the bytes. `Hello` restarts the stream and is
    /// sent after a delimiter.
    pub fn request(&mut self, command: Command) -> (u16, Vec<u8>) {
        let id = self.last_id.wrapping_add(1).max(1);
        self.last_id = id;
        let mut bytes = Vec::new();
        if command == Command::Hello {
            self.sequence = SequenceCounter::default();
            bytes.push(DELIMITER);
        }
        let mut frame = [0; MAX_FRAME];
        // A frame of maximum length can hold every command.
        let length = encode_request(&Request { id, command }, self.sequence.take(), &mut frame).unwrap_or(0);
        bytes.extend_from_slice(&frame[..length]);
        (id, bytes)
    }

    /// Decodes bytes from the device.
    pub fn take(&mut self, mut bytes: &[u8]) {
        while let Some(frame) = self.reader.read(&mut bytes) {
            match frame {
                Frame::Message { message, .. } => self.records.push_back(message),
                Frame::Lost { frames } => self.lost += u64::from(frames),
                _ => {}
            }
        }
    }

    /// Removes and returns the reply to a request, if it has arrived; other records stay.
    pub fn reply(&mut self, id: u16) -> Option<Reply> {
        let of_id = |record: &Record| matches!(record, Record::Reply(reply) if reply.id == id);
        match self.records.remove(self.records.iter().position(of_id)?) {
            Some(Record::Reply(reply)) => Some(reply),
            _ => None,
        }
    }

    /// Removes and returns all records that have arrived.
    pub fn records(&mut self) -> Vec<Record> {
        self.records.drain(..).collect()
    }

    /// Counters of the frame reader, including damaged frames.
    pub fn counts(&self) -> &Counts {
        self.reader.counts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_wire::{Done, encode_record};

    #[test]
    fn replies_find_their_requests_and_losses_are_counted() {
        let mut talk = Talk::default();
        let (first, bytes) = talk.request(Command::Hello);
        assert_eq!((first, bytes[0]), (1, DELIMITER));
        let (second, _) = talk.request(Command::ReadSettings);
        let mut frame = [0; MAX_FRAME];
        for (sequence, id) in [(0, second), (2, 77), (3, first)] {
            let reply = Record::Reply(Reply { id, result: Ok(Done::Plain) });
            let length = encode_record(&reply, sequence, &mut frame).expect("the record fits in a frame");
            talk.take(&frame[..length]);
        }
        assert_eq!(talk.reply(first), Some(Reply { id: first, result: Ok(Done::Plain) }));
        assert_eq!(talk.reply(first), None);
        assert!(talk.reply(second).is_some());
        assert_eq!((talk.lost, talk.records().len()), (1, 1));
    }
}
