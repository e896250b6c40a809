//! The start of a run: saved settings, the end of the previous run, and which host is told about it.

use crate::flash::{Flash, RANGE};
use crate::rig::{IDENTITY, MemoryStore, Options, TestDevice, able_to, begun, done, events, live, shaken};
use embassy_futures::block_on;
use embassy_time::{Duration, MockDriver};
use inerter_app::{FlashStore, Identity, Pace, SourceError, Start, Store, StoreError};
use inerter_core::{Settings, SettingsError};
use inerter_wire::{
    Capabilities, Command, Event, EventKind, Fault, Frame, FrameReader, Hello, MAX_FRAME, Record, Refusal, ResetCause,
    SettingFault, SettingValue, SettingsValues, Source, encode_record,
};

fn with_store(store: &MemoryStore) -> Options {
    Options { store: store.clone(), ..Options::default() }
}

/// The first events of a device with this store.
fn first_events(store: &MemoryStore) -> Vec<EventKind> {
    events(&TestDevice::cold(with_store(store)).records())
}

fn after_power_on(fault: Fault) -> Vec<EventKind> {
    vec![EventKind::Started, EventKind::ResetBy(ResetCause::PowerOn), EventKind::Fault(fault)]
}

#[test]
fn unusable_saved_settings_are_said_and_left() {
    let store = MemoryStore::default();
    let place = |name| Settings::find(name).unwrap();
    let good = SettingsValues::from(&Settings::default());
    let mut not_finite = good.clone();
    not_finite.0[0].value = f64::NAN;
    let mut contradictory = good.clone();
    contradictory.0[place("force_min_code")].value = 5.0;
    contradictory.0[place("force_max_code")].value = -5.0;
    for saved in [not_finite, contradictory] {
        *store.saved.borrow_mut() = Some(saved.clone());
        assert_eq!(first_events(&store), after_power_on(Fault::SavedSettings));
        let kept = format!("{:?}", store.saved.borrow());
        assert_eq!(kept, format!("{:?}", Some(saved)), "kept until the user saves");
    }
}

#[test]
fn what_the_store_cannot_give_is_said_and_kept_until_the_user_saves() {
    for (error, fault) in [
        (StoreError::Unreadable, Fault::Store),
        (StoreError::Newer, Fault::NewerSettings),
        (StoreError::Foreign, Fault::ForeignSettings),
    ] {
        let store = MemoryStore::default();
        *store.error.borrow_mut() = Some(error);
        let mut rig = TestDevice::cold(with_store(&store));
        assert_eq!(events(&rig.records()), after_power_on(fault));
        assert_eq!(rig.settings(), Settings::default());
        assert_eq!(*store.error.borrow(), Some(error), "left as it was");
        let usable = error != StoreError::Unreadable;
        assert_eq!(rig.result(Command::SaveSettings).is_ok(), usable);
        drop(rig);
        assert_eq!(first_events(&store).len(), if usable { 2 } else { 3 });
    }
}

/// The settings that the flash returns after saving these.
fn kept(flash: &Flash, settings: &SettingsValues) -> SettingsValues {
    block_on(FlashStore::new(flash.clone(), RANGE).save(settings)).unwrap();
    block_on(FlashStore::new(flash.clone(), RANGE).load()).unwrap().unwrap()
}

#[test]
fn saved_settings_outlive_an_update_a_downgrade_and_an_update_again() {
    let (flash, store) = (Flash::blank(), MemoryStore::default());
    let used = Settings { sample_rate_hz: 500.0, memory_s: 12.0, ..Settings::default() };
    let first = SettingsValues(SettingsValues::from(&used).0.into_iter().take(20).collect());
    let later = SettingValue { number: 47, value: 1.0 };

    // The first firmware knew 20 settings. This one takes the others from its defaults, and saves all of them.
    *store.saved.borrow_mut() = Some(kept(&flash, &first));
    let mut updated = TestDevice::cold(with_store(&store));
    assert_eq!(events(&updated.records()), [EventKind::Started, EventKind::ResetBy(ResetCause::PowerOn)]);
    assert_eq!(updated.settings(), used);
    let changed = Settings { terminal_sensor: true, ..used };
    updated.tell(Command::WriteSettings(SettingsValues::difference(&changed, &used)));
    updated.tell(Command::SaveSettings);
    drop(updated);

    // A later firmware knew one more. After the downgrade it is ignored, but stays saved.
    let mut saved = kept(&flash, store.saved.borrow().as_ref().unwrap());
    saved.0.push(later).unwrap();
    *store.saved.borrow_mut() = Some(kept(&flash, &saved));
    let mut downgraded = TestDevice::cold(with_store(&store));
    assert_eq!(events(&downgraded.records()), [EventKind::Started, EventKind::ResetBy(ResetCause::PowerOn)]);
    assert_eq!(downgraded.settings(), changed);
    assert_eq!(*store.saved.borrow(), Some(saved.clone()), "the later firmware finds its own when it comes back");

    // After this firmware saves, only its own settings remain.
    downgraded.tell(Command::WriteSettings(SettingsValues::difference(&used, &changed)));
    downgraded.tell(Command::SaveSettings);
    assert_eq!(*store.saved.borrow(), Some(SettingsValues::from(&used)));
    drop(downgraded);

    // The first firmware reads the settings that it knows: by number, from the beginning of the list.
    let left = kept(&flash, store.saved.borrow().as_ref().unwrap());
    assert_eq!(left.0.get(..20), first.0.get(..));
}

/// A board that supports three rates.
fn three_rates(settings: &Settings) -> Result<(), SettingsError> {
    let (value, offered) = (settings.sample_rate_hz, &[1000.0, 2000.0, 4000.0]);
    if offered.contains(&value) {
        return Ok(());
    }
    Err(SettingsError::NotOffered { field: "sample_rate_hz", value, offered })
}

const PICKY: Identity<'static> = Identity { accepts: three_rates, ..IDENTITY };

#[test]
fn what_the_board_does_not_offer_is_refused_before_anything_changes() {
    let mut rig = TestDevice::with(Options { identity: PICKY, ..Options::default() });
    rig.script.asked();
    let write = |rate| {
        let values = [SettingValue { number: 17, value: 10.0 }, SettingValue { number: 0, value: rate }];
        Command::WriteSettings(SettingsValues(heapless::Vec::from_slice(&values).unwrap()))
    };
    let (before, result, after) = rig.ask(write(3000.0));
    let refusal = Refusal::BadSetting { number: 0, fault: SettingFault::NotOffered };
    assert_eq!((before, result, after), (vec![], Err(refusal), vec![]));
    assert_eq!(rig.settings(), Settings::default());
    assert_eq!(rig.script.asked(), [], "the source was not touched");
    rig.tell(write(2000.0));
    assert_eq!(rig.settings(), Settings { sample_rate_hz: 2000.0, memory_s: 10.0, ..Settings::default() });
}

#[test]
fn saved_settings_that_the_board_does_not_offer_are_left() {
    let store = MemoryStore::default();
    *store.saved.borrow_mut() = Some(SettingsValues::from(&Settings { sample_rate_hz: 3000.0, ..Settings::default() }));
    let mut rig = TestDevice::cold(Options { identity: PICKY, ..with_store(&store) });
    assert_eq!(events(&rig.records()), after_power_on(Fault::SavedSettings));
    assert_eq!(rig.settings(), Settings::default());
    drop(rig);
    let defaults = Settings { sample_rate_hz: 3000.0, ..Settings::default() };
    let mut rig = TestDevice::cold(Options { identity: PICKY, defaults, ..Options::default() });
    rig.settle();
    let ended = rig.ended.take().unwrap().unwrap_err();
    assert_eq!(ended.to_string(), "sample_rate_hz: the board does not offer 3000, but 1000, 2000 and 4000");
}

#[test]
fn what_is_saved_can_be_looked_at_without_its_use() {
    let store = MemoryStore::default();
    let mut rig = TestDevice::with(with_store(&store));
    assert_eq!(rig.ask(Command::ReadSaved), (vec![], Err(Refusal::NothingSaved), vec![]));
    let kept = Settings { newtons_per_code: 0.004, skew_s: 1e-5, ..Settings::default() };
    *store.saved.borrow_mut() = Some(SettingsValues::from(&kept));
    assert_eq!(rig.tell(Command::ReadSaved), [Record::Saved(SettingsValues::from(&kept))]);
    assert_eq!(rig.settings(), Settings::default(), "not in use");
    assert_eq!(*store.saved.borrow(), Some(SettingsValues::from(&kept)));
    for error in [StoreError::Newer, StoreError::Foreign, StoreError::Unreadable] {
        *store.error.borrow_mut() = Some(error);
        assert_eq!(rig.ask(Command::ReadSaved), (vec![], Err(Refusal::SavedUnreadable), vec![]));
    }
    drop(rig);
    let mut rig = TestDevice::with(able_to(Capabilities::NONE));
    assert_eq!(rig.ask(Command::ReadSaved), (vec![], Err(Refusal::Unsupported), vec![]));
}

#[test]
fn a_factory_reset_forgets_what_was_saved_and_uses_the_boards_defaults() {
    let store = MemoryStore::default();
    let defaults = Settings { newtons_per_code: 0.004, ..Settings::default() };
    let options = Options { defaults, ..with_store(&store) };
    *store.saved.borrow_mut() = Some(SettingsValues::from(&Settings { skew_s: 1e-5, ..defaults }));
    let mut rig = TestDevice::with(options.clone());
    assert_eq!(rig.settings().skew_s, 1e-5);
    let records = rig.tell(Command::FactoryReset);
    assert_eq!(events(&records), [EventKind::EstimatorReset, EventKind::SettingsChanged]);
    assert_eq!(records.last(), Some(&Record::Settings(SettingsValues::from(&defaults))));
    assert_eq!(*store.saved.borrow(), None);
    assert_eq!(rig.settings(), defaults);
    // Also if the store contains foreign data.
    *store.error.borrow_mut() = Some(StoreError::Foreign);
    assert_eq!(events(&rig.tell(Command::FactoryReset)), [EventKind::SettingsChanged]);
    assert_eq!(*store.error.borrow(), None);
    // If the store cannot be erased, nothing changes. The pause restores the allowance for flash writes.
    rig.pass(600_000);
    rig.tell(Command::WriteSettings(SettingsValues::from(&Settings { skew_s: 2e-5, ..defaults })));
    *store.error.borrow_mut() = Some(StoreError::Unreadable);
    assert_eq!(rig.ask(Command::FactoryReset), (vec![], Err(Refusal::Store), vec![]));
    assert_eq!(rig.settings().skew_s, 2e-5);
}

#[test]
fn what_ended_the_run_before_is_told() {
    let told = |start| {
        let mut records = TestDevice::cold(begun(start)).records();
        assert!(matches!(records.remove(1), Record::Hello(_)));
        let mut kinds = events(&records);
        assert_eq!(kinds.remove(0), EventKind::Started);
        kinds
    };
    let cause = |cause| Start { cause, ..Start::POWER_ON };
    assert_eq!(told(cause(ResetCause::Pin)), [EventKind::ResetBy(ResetCause::Pin)]);
    assert_eq!(
        told(cause(ResetCause::Watchdog)),
        [EventKind::ResetBy(ResetCause::Watchdog), EventKind::Fault(Fault::Watchdog)]
    );
    let long =
        "at src/main.rs:12: a message that is longer than what fits, far beyond the 96 bytes that a text may have";
    let kinds = told(Start { cause: ResetCause::Panic, panic: Some(long), ..Start::POWER_ON });
    let [EventKind::ResetBy(ResetCause::Panic), EventKind::Panicked(text)] = kinds.as_slice() else {
        panic!("{kinds:?}")
    };
    assert_eq!(text.as_str(), &long[..96]);
}

/// A device after a panic, with USB and a UART.
fn crashed() -> Options {
    let start = Start { cause: ResetCause::Panic, panic: Some("at src/main.rs:1"), ..Start::POWER_ON };
    let store = MemoryStore::default();
    *store.error.borrow_mut() = Some(StoreError::Newer);
    Options { store, two_links: true, autostart: true, pace: Pace::Live, ..begun(start) }
}

/// The events that it must report.
fn events_of_a_panic() -> Vec<EventKind> {
    vec![
        EventKind::Started,
        EventKind::ResetBy(ResetCause::Panic),
        EventKind::Panicked(Hello::text("at src/main.rs:1")),
        EventKind::Fault(Fault::NewerSettings),
    ]
}

/// The intact messages.
fn messages(frames: impl IntoIterator<Item = Frame<Record>>) -> Vec<Record> {
    let message = |frame| if let Frame::Message { message, .. } = frame { Some(message) } else { None };
    frames.into_iter().filter_map(message).collect()
}

#[test]
fn a_device_is_mute_until_a_host_says_something_valid() {
    let mut rig = TestDevice::cold(crashed());
    let mut samples = shaken(20_000).into_iter();
    let mut pass = |rig: &mut TestDevice| {
        for sample in samples.by_ref().take(3_000) {
            rig.script.push([Ok(sample)]);
            rig.pass(1);
        }
    };
    pass(&mut rig);
    rig.set_open(true);
    pass(&mut rig);
    assert!(rig.app.link_state().is_mute());
    assert_eq!((rig.from_device.waiting(), rig.uart.1.waiting()), (0, 0));
    // Bytes that a terminal or ModemManager may send, and an echo of the device's own output.
    rig.send_bytes(b"AT+GCAP\r\0ATI\r\n\0");
    let mut echo = [0; MAX_FRAME];
    let started = Record::Event(Event { index: 0, kind: EventKind::Started });
    let length = encode_record(&started, 0, &mut echo).unwrap();
    rig.send_bytes(&echo[..length]);
    pass(&mut rig);
    assert_eq!(rig.from_device.waiting(), 0);

    rig.send_bytes(&[0]);
    let id = rig.send(Command::Hello);
    let frames = rig.frames();
    let Some(Frame::Message { sequence: 0, message }) = frames.first() else { panic!("{frames:?}") };
    assert_eq!(*message, started, "the stream begins with it");
    assert!(frames.iter().all(|frame| matches!(frame, Frame::Message { .. })), "{frames:?}");
    let records = messages(frames);
    assert_eq!(events(&records), events_of_a_panic());
    assert!(matches!(records[1], Record::Hello(_)));
    assert_eq!(records.last(), Some(&done(id)));
    let health = rig.health();
    assert_eq!((health.dropped_frames, health.bad_frames), (0, 3), "nobody was there to miss anything");
}

/// No gap can be seen before the first frame, so what is dropped while the host is greeted must leave one after it.
#[test]
fn what_is_dropped_as_the_stream_begins_is_missing_after_its_first_frame() {
    let mut rig = TestDevice::cold(Options { two_links: true, ..live() });
    rig.set_open(true);
    rig.settle();
    let samples = shaken(1_000);
    let (last, before) = samples.split_last().unwrap();
    for sample in before {
        rig.pass(1);
        rig.feed([sample]);
    }
    // The first request arrives in the millisecond in which an estimate and a health record are due.
    MockDriver::get().advance(Duration::from_millis(1));
    rig.send(Command::Hello);
    rig.feed([last]);
    let frames = rig.frames();
    let Some(Frame::Message { sequence: 0, message: Record::Event(Event { kind: EventKind::Started, .. }) }) =
        frames.first()
    else {
        panic!("{frames:?}");
    };
    let health = rig.health();
    assert!(health.dropped_frames > 0);
    assert_eq!(health.dropped_frames, rig.lost());
}

#[test]
fn the_next_host_is_told_nothing_old() {
    let mut rig = TestDevice::cold(crashed());
    rig.set_open(true);
    assert_eq!(events(&rig.tell(Command::Hello)), events_of_a_panic());
    for _ in 0..3 {
        rig.set_open(false);
        rig.pass(100);
        rig.set_open(true);
        rig.pass(2_000);
        assert_eq!(rig.from_device.waiting(), 0, "mute again");
        rig.send_bytes(&[0]);
        let id = rig.send(Command::Hello);
        let records = messages(rig.frames());
        let [Record::Hello(_), Record::Reply(reply)] = records.as_slice() else { panic!("{records:?}") };
        assert_eq!(reply.id, id);
    }
    assert_eq!(rig.health().dropped_frames, 0, "nobody missed anything");
}

#[test]
fn a_host_that_leaves_before_it_was_told_leaves_the_story_to_the_next() {
    let mut rig = TestDevice::cold(crashed());
    rig.set_open(true);
    // A few of the bytes fit, then the host disappears.
    rig.set_room(20);
    rig.send(Command::Hello);
    rig.pass(10);
    rig.set_open(false);
    rig.pass(2_000);
    rig.from_device.take();
    rig.set_room(usize::MAX);
    rig.set_open(true);
    rig.send_bytes(&[0]);
    rig.send(Command::Hello);
    assert_eq!(events(&messages(rig.frames())), events_of_a_panic());
}

#[test]
fn a_host_after_one_that_did_not_read_has_its_time() {
    let mut rig = TestDevice::cold(crashed());
    rig.set_open(true);
    rig.tell(Command::Hello);
    rig.set_room(0);
    rig.pass(3_000);
    rig.set_open(false);
    rig.pass(10);
    rig.set_open(true);
    rig.send_bytes(&[0]);
    let id = rig.send(Command::Hello);
    // Longer than the time limit for a frame on a link that is known not to be read.
    rig.pass(500);
    rig.set_room(usize::MAX);
    assert!(matches!(messages(rig.frames()).as_slice(), [Record::Hello(_), last] if *last == done(id)));
}

#[test]
fn a_request_on_the_uart_is_obeyed_while_usb_is_away_and_only_then() {
    let mut rig = TestDevice::cold(crashed());
    let (_, hello) = rig.request(Command::Hello);
    rig.uart.0.put(&hello);
    rig.settle();
    assert!(rig.uart.1.waiting() > 0);
    assert_eq!(rig.from_device.waiting(), 0);
    rig.pass(1_000);
    rig.uart.1.take();
    rig.set_open(true);
    let (_, stop) = rig.request(Command::Stop);
    rig.uart.0.put(&stop);
    rig.pass(3_000);
    assert_eq!((rig.uart.0.waiting(), rig.uart.1.waiting()), (0, 0), "taken and dropped");
    rig.set_open(false);
    rig.pass(2_000);
    // The host spoke to the UART before, so output continues there, and nothing has stopped.
    let bytes = rig.uart.1.take();
    let mut reader = FrameReader::<Record>::new();
    let mut input = bytes.as_slice();
    let records = messages(std::iter::from_fn(|| reader.read(&mut input)));
    assert!(!events(&records).contains(&EventKind::SourceChanged(Source::Stopped)));
    assert!(matches!(records.as_slice(), [Record::Health(_), ..]), "{records:?}");
}

#[test]
fn a_source_that_does_not_come_up_is_told_with_the_start() {
    let options = Options { configured: Err(SourceError::Unreadable), autostart: true, ..crashed() };
    let mut rig = TestDevice::cold(options);
    rig.pass(1_000);
    rig.set_open(true);
    let mut expected = events_of_a_panic();
    expected.push(EventKind::Fault(Fault::SourceUnreadable));
    assert_eq!(events(&rig.tell(Command::Hello)), expected);
    drop(rig);
    // A board without a sampler has no source that could fail.
    let configured = Err(SourceError::Unreadable);
    let mut rig = TestDevice::cold(Options { configured, ..able_to(Capabilities::NONE) });
    assert_eq!(events(&rig.records()), [EventKind::Started, EventKind::ResetBy(ResetCause::PowerOn)]);
}
