use inerter_core::{Detail, Estimate};
use inerter_wire::Samples;

use super::*;
use crate::hostile::hello;

fn received(time_ns: u64, message: Record) -> Received {
    Received { time_ns, bytes: vec![1], frame: Frame::Message { message, sequence: 0 } }
}

fn settings() -> Settings {
    Settings { sample_rate_hz: 1000.0, newtons_per_code: 0.5, metres_per_count: 2e-6, ..Settings::default() }
}

fn connect(feed: &mut Feed) -> Item {
    feed.connected("port", &hello("test", "board", "7", 1000.0), &settings())
}

/// A feed whose device has just been connected.
fn connected() -> Feed {
    let mut feed = Feed::default();
    connect(&mut feed);
    feed
}

fn batch(from: u32, count: u32) -> Record {
    let samples: Vec<_> = (0..count)
        .map(|after| from.wrapping_add(after))
        .map(|index| inerter_core::RawSample { index, position_count: 500, force_code: 20, terminal_code: 0 })
        .collect();
    Record::Samples(Samples::from_slice(&samples).0)
}

fn estimate(index: u32, elapsed_samples: u64) -> Estimate {
    Estimate { index, elapsed_samples, ..Estimate::default() }
}

fn items(feed: &mut Feed, time_ns: u64, record: Record) -> Vec<Item> {
    let mut items = Vec::new();
    feed.received(&received(time_ns, record), 0, |item| items.push(item));
    items
}

fn times(items: &[Item]) -> Vec<f64> {
    let of = |item: &Item| match item {
        Item::Samples(samples) => samples.iter().map(|sample| sample.at.run_s).collect(),
        _ => Vec::new(),
    };
    items.iter().flat_map(of).collect()
}

#[test]
fn samples_come_in_si_units_on_one_time_line() {
    let mut feed = Feed::default();
    assert!(matches!(connect(&mut feed), Item::Device { .. }));
    let first = items(&mut feed, 5_000_000_000, batch(100, 3));
    let Some(Item::Samples(samples)) = first.first() else { panic!("{first:?}") };
    let sample = samples[1];
    assert_eq!((sample.force_n, sample.position_m, sample.terminal_m), (10.0, 1e-3, None));
    assert_eq!((sample.at.run_s, sample.at.unix_ns), (1e-3, 5_001_000_000));
    // The host's clock sets where the timeline begins, the device's how it continues.
    for (index, run_s) in [(103, 3e-3), (1103, 1.003)] {
        let later = times(&items(&mut feed, 9_000_000_000, batch(index, 1)));
        assert!(matches!(later[..], [time] if (time - run_s).abs() < 1e-9), "{later:?}");
    }
}

#[test]
fn a_restart_goes_on_where_the_host_s_clock_is() {
    let mut feed = connected();
    items(&mut feed, 1_000_000_000, batch(70_000, 1));
    connect(&mut feed);
    assert_eq!(times(&items(&mut feed, 3_500_000_000, batch(0, 2))), [2.5, 2.501]);
    // A counter that wraps is not a restart.
    let mut feed = connected();
    assert_eq!(times(&items(&mut feed, 0, batch(u32::MAX, 1))), [0.0]);
    assert_eq!(times(&items(&mut feed, 0, batch(0, 1))), [1e-3]);
}

#[test]
fn an_estimate_waits_for_its_detail_and_no_longer() {
    let mut feed = connected();
    assert_eq!(items(&mut feed, 0, Record::Estimate(estimate(9, 10))), []);
    let detail = Detail { index: 9, ..Detail::default() };
    let shown = items(&mut feed, 0, Record::Detail(detail));
    assert!(
        matches!(&shown[..], [Item::Estimate { t_s: 9e-3, estimated: Estimated { detail: Some(_), .. }, .. }]),
        "{shown:?}"
    );

    // An estimate of an older firmware is shown when the next one arrives, or when nothing does.
    items(&mut feed, 0, Record::Estimate(estimate(19, 20)));
    let shown = items(&mut feed, 0, Record::Estimate(estimate(29, 30)));
    assert!(
        matches!(&shown[..], [Item::Estimate { t_s: 19e-3, estimated: Estimated { detail: None, .. }, .. }]),
        "{shown:?}"
    );
    let mut late = Vec::new();
    feed.quiet(DETAIL_NS - 1, |item| late.push(item));
    assert!(late.is_empty(), "a busy line may still bring it");
    feed.quiet(DETAIL_NS, |item| late.push(item));
    assert!(matches!(&late[..], [Item::Estimate { t_s: 29e-3, .. }]), "{late:?}");
    // A detail of another estimate is ignored.
    items(&mut feed, 0, Record::Estimate(estimate(39, 40)));
    assert_eq!(items(&mut feed, 0, Record::Detail(detail)), []);
}

#[test]
fn a_marker_has_the_time_of_the_latest_sample_on_either_clock() {
    let mut feed = connected();
    assert!(matches!(feed.marker("early"), Item::Marker { t_s: None, .. }));
    items(&mut feed, 0, batch(1000, 1));
    items(&mut feed, 0, Record::Estimate(estimate(1001, 501)));
    feed.quiet(DETAIL_NS, |_| {});
    items(&mut feed, 0, batch(1011, 1));
    let Item::Marker { at, t_s, text } = feed.marker("here") else { panic!("no marker") };
    assert_eq!((at.run_s, text.as_str()), (11e-3, "here"));
    assert!(t_s.is_some_and(|t_s| (t_s - 0.510).abs() < 1e-9), "{t_s:?}");
}

#[test]
fn frames_lost_are_told_once_each_time() {
    let mut feed = Feed::default();
    let mut shown = Vec::new();
    for lost in [0, 2, 2, 3] {
        feed.received(&received(0, Record::Health(Health::default())), lost, |item| shown.push(item));
    }
    let told: Vec<&Item> = shown.iter().filter(|item| matches!(item, Item::LostFrames(_))).collect();
    assert_eq!(told, [&Item::LostFrames(2), &Item::LostFrames(3)]);
}

#[test]
fn frames_of_unknown_kind_are_told_with_the_health() {
    let mut feed = Feed::default();
    let mut shown = Vec::new();
    let unknown =
        Received { time_ns: 0, bytes: vec![1], frame: Frame::Unknown { sequence: 0, number: 200, request: None } };
    let health = received(0, Record::Health(Health::default()));
    for finding in [&health, &unknown, &unknown, &health, &health, &unknown, &health] {
        feed.received(finding, 0, |item| shown.push(item));
    }
    let told: Vec<&Item> = shown.iter().filter(|item| matches!(item, Item::UnknownFrames(_))).collect();
    assert_eq!(told, [&Item::UnknownFrames(2), &Item::UnknownFrames(3)]);
}
