//! The requests in a stream.

use inerter_wire::{Command, Frame, FrameReader, Request};

/// The contents of a stream, by an independent reader.
#[derive(Clone, Debug, Default)]
pub struct Requests {
    /// Intact requests in order: ID, and the command if it is known.
    pub intact: Vec<(u16, Option<Command>)>,
    /// Frames that are damaged or contain nothing that can be answered.
    pub bad_frames: u32,
}

impl Requests {
    /// The requests in a stream, which includes its probe.
    pub fn read(stream: &[u8]) -> Self {
        let mut requests = Self::default();
        let mut reader = FrameReader::<Request>::new();
        let mut input = stream;
        while let Some(frame) = reader.read(&mut input) {
            match frame {
                Frame::Message { message: Request { id, command }, .. } => requests.intact.push((id, Some(command))),
                Frame::Unknown { request: Some(id), .. } => requests.intact.push((id, None)),
                Frame::Unknown { .. } | Frame::Corrupt(_) => requests.bad_frames += 1,
                Frame::Lost { .. } | Frame::Restarted | Frame::ForeignVersion { .. } => {}
            }
        }
        requests
    }

    /// Number of replies due: none after a restart.
    pub(super) fn replies(&self) -> usize {
        let restart = self.intact.iter().position(|(_, command)| command.as_ref().is_some_and(restarts));
        restart.map_or(self.intact.len(), |place| place + 1)
    }

    /// Number of requests that the device may need time for.
    pub(super) fn that_wait(&self) -> usize {
        let waits = |command: &Command| matches!(command, Command::Tare | Command::Inject(_) | Command::InjectEnd);
        self.intact.iter().filter(|(_, command)| command.as_ref().is_some_and(waits)).count()
    }
}

/// Whether the command restarts the device.
pub(super) fn restarts(command: &Command) -> bool {
    matches!(command, Command::EnterDfu | Command::Reboot)
}
