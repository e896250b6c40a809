//! Passes records from the device to the recording and to all viewers.

use std::sync::mpsc::{Receiver, Sender, channel};

use inerter_data::recording::{End, Recorder};
use inerter_device::{
    Device, DeviceError, Received,
    live::{LinkEvent, Live},
};
use inerter_simulate::share::Share;
use inerter_wire::{Command, DELIMITER, Frame, Record, Reply};

use super::{
    causes::Causes,
    feed::{Feed, Item},
};
use crate::Error;

/// A viewer of the data. Something that cannot be shown ends the monitor only if `show` returns an error.
pub trait Viewer {
    /// Shows one item.
    fn show(&mut self, item: &Item) -> Result<(), Error>;

    /// No more items for the moment.
    fn pause(&mut self) -> Result<(), Error> {
        Ok(())
    }

    /// No more items will come: shows what is still queued.
    fn end(&mut self) -> Result<(), Error> {
        Ok(())
    }
}

/// What viewers may request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
    /// A marker, at the current time.
    Mark(String),
    /// Makes the estimator forget all motion.
    ResetEstimator,
}

/// The device, the recording and the viewers.
pub struct Hub {
    live: Live,
    feed: Feed,
    causes: Causes,
    /// Records everything.
    pub recorder: Option<Recorder>,
    /// Lets other programs watch the device.
    pub share: Option<Share>,
    /// Request number of the latest reset, until its reply arrives.
    asked: Option<u16>,
    viewers: Vec<Box<dyn Viewer + Send>>,
    wishes: (Sender<Wish>, Receiver<Wish>),
    wait_s: f64,
}

impl Hub {
    /// For a device that is connected.
    pub fn new(live: Live, wait_s: f64) -> Self {
        Self {
            live,
            feed: Feed::default(),
            causes: Causes::default(),
            recorder: None,
            share: None,
            asked: None,
            viewers: Vec::new(),
            wishes: channel(),
            wait_s,
        }
    }

    /// The channel that takes requests.
    pub fn wishes(&self) -> Sender<Wish> {
        self.wishes.0.clone()
    }

    /// Adds a viewer.
    pub fn add(&mut self, viewer: impl Viewer + Send + 'static) {
        self.viewers.push(Box::new(viewer));
    }

    /// Runs until `stop` returns true or something fails. In either case the recording is closed properly.
    pub fn run(mut self, stop: impl Fn() -> bool) -> Result<(), Error> {
        let result = self.turn_by_turn(stop);
        let lost_frames = self.live.lost_frames();
        let reason = result.as_ref().err().map_or_else(|| "finished".into(), ToString::to_string);
        let closed = self.recorder.map_or(Ok(()), |recorder| recorder.close(&End { reason, lost_frames }));
        // After the recording is safely closed.
        let shown = self.viewers.iter_mut().try_for_each(|viewer| viewer.end());
        result.and_then(|()| Ok(closed?)).and(shown)
    }

    fn turn_by_turn(&mut self, stop: impl Fn() -> bool) -> Result<(), Error> {
        if let (Some(device), Some(recorder)) = (self.live.device(), &mut self.recorder) {
            recorder.describe(device.hello(), device.settings())?;
        }
        self.introduce()?;
        while !stop() {
            self.wished()?;
            self.share.iter_mut().for_each(Share::turn);
            match self.live.next()? {
                LinkEvent::Received(received) => {
                    if let Some(recorder) = self.recorder.as_mut().filter(|_| !received.bytes.is_empty()) {
                        recorder.frame(received.time_ns, &received.bytes)?;
                    }
                    if let Some(share) = &mut self.share {
                        share.relay(&received.bytes);
                        share.relay(&[DELIMITER]);
                    }
                    let mut items: Vec<Item> = self.refused(&received).into_iter().collect();
                    self.feed.received(&received, self.live.lost_frames(), |item| items.push(item));
                    if let Frame::Message { message: Record::Samples(batch), .. } = &received.frame
                        && batch.check().is_ok()
                    {
                        batch.iter().flatten().for_each(|sample| self.causes.sample(sample));
                    }
                    self.show(items)?;
                }
                LinkEvent::Quiet => {
                    if let Some(recorder) = &mut self.recorder {
                        recorder.quiet(self.live.now_ns())?;
                    }
                    self.settle()?;
                }
                LinkEvent::Away { reason } => {
                    self.share.iter_mut().for_each(Share::forget);
                    self.settle()?;
                    if let Some(recorder) = &mut self.recorder {
                        recorder.flush()?;
                    }
                    let reason = format!("{reason}; waiting {} s for it to come back", self.wait_s);
                    self.show(vec![Item::Away { reason }])?;
                }
                LinkEvent::Back => {
                    self.introduce()?;
                    let port = self.live.device().map(|device| device.name().to_string()).unwrap_or_default();
                    self.show(vec![Item::Back { port }])?;
                }
            }
        }
        Ok(())
    }

    /// The request that this frame refuses, if any.
    fn refused(&mut self, received: &Received) -> Option<Item> {
        let Frame::Message { message: Record::Reply(Reply { id, result }), .. } = &received.frame else { return None };
        self.asked.take_if(|asked| *asked == *id)?;
        let refusal = result.err()?;
        Some(Item::Refused { words: format!("the device refused to reset its estimator: {refusal}") })
    }

    /// Announces the device.
    fn introduce(&mut self) -> Result<(), Error> {
        let Some(device) = self.live.device() else { return Ok(()) };
        let item = self.feed.device(device);
        self.show(vec![item])
    }

    /// Emits items that were held back.
    fn settle(&mut self) -> Result<(), Error> {
        let mut items = Vec::new();
        self.feed.quiet(self.live.now_ns(), |item| items.push(item));
        self.show(items)?;
        self.viewers.iter_mut().try_for_each(|viewer| viewer.pause())
    }

    fn wished(&mut self) -> Result<(), Error> {
        while let Ok(wish) = self.wishes.1.try_recv() {
            match wish {
                Wish::Mark(text) => {
                    if let Some(recorder) = &mut self.recorder {
                        recorder.marker(self.live.now_ns(), &text)?;
                    }
                    let item = self.feed.marker(&text);
                    self.show(vec![item])?;
                }
                // The device confirms with an event. A device that went away has lost its state anyway.
                Wish::ResetEstimator => {
                    if let Some(device) = self.live.device_mut() {
                        self.asked = reset(device)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn show(&mut self, items: Vec<Item>) -> Result<(), Error> {
        let found: Vec<Item> = items.iter().flat_map(|item| self.causes.look(item)).collect();
        for item in items.iter().chain(&found) {
            self.viewers.iter_mut().try_for_each(|viewer| viewer.show(item))?;
        }
        Ok(())
    }
}

/// Sends the request without waiting for the reply, since samples continue meanwhile; returns the request number. If
/// the link breaks here, the next read reports it.
fn reset(device: &mut Device) -> Result<Option<u16>, DeviceError> {
    match device.send(Command::ResetEstimator) {
        Err(error) if !error.may_come_back() => Err(error),
        result => Ok(result.ok()),
    }
}
