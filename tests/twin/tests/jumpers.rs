//! The self-test with jumpers, against the shipping image: it passes on a sound board and names each planted fault.

use crate::common::{self, carried_by};
use inerter_jumpers::{Board as Keeper, JumperError, Report, run, run_with, truth};
use inerter_plant::Inerter;
use inerter_twin::Board;
use inerter_twin::chip::Pin;
use inerter_twin::chip::adc::Quality;
use inerter_twin::chip::dac;
use inerter_twin::chip::dmamux::Request;
use inerter_twin::chip::errata::Errata;
use inerter_twin::chip::gpio::Mode;
use inerter_twin::chip::jumpers::Jumpers;
use inerter_twin::machine::{Machine, Options, shipping_image};
use inerter_twin::usb_link::UsbLink;
use inerter_twin::world::Still;
use inerter_wire::{Command, Done, Knot, Play, Record, Refusal, SettingsValues};

/// The firmware has started by this time \[s\].
const STARTED_S: f64 = 0.3;
/// Time limit for a reply \[s\].
const REPLY_S: f64 = 1.0;

/// A board with jumpers, and a host that stores each record with its time.
struct Lab {
    link: UsbLink<Machine>,
    records: Vec<(f64, Record)>,
}

impl Lab {
    /// The settings in use, as last reported by the device.
    fn settings(&mut self) -> Option<SettingsValues> {
        self.request(Command::ReadSettings).expect("a reply");
        self.listen(0.05).expect("listens");
        let last = self.records().into_iter().rev();
        last.map(|(_, record)| record).find_map(carried_by!(Record::Settings))
    }

    /// Runs the whole test, then checks that it restored the settings and released the pins.
    fn run(&mut self) -> Result<Report, JumperError> {
        let before = self.settings();
        assert!(before.is_some());
        let outcome = run(self, false);
        assert_eq!(self.settings(), before, "the settings in use");
        for pin in [('A', 4), ('A', 6), ('B', 1), ('B', 2)] {
            assert_eq!(self.link.socket.chip().pin_mode(Pin::new(pin.0, pin.1)), Mode::Analog, "{pin:?} is let go");
        }
        outcome
    }

    fn keep(&mut self) {
        let now_s = self.link.socket.time_s();
        self.records.extend(self.link.talk.records().into_iter().map(|record| (now_s, record)));
    }
}

impl Keeper for Lab {
    fn request(&mut self, command: Command) -> Result<Done, JumperError> {
        let reply = self.link.request(command, REPLY_S).map_err(|error| JumperError::Link(error.to_string()))?;
        self.keep();
        reply.result.map_err(|why| JumperError::Refused { doing: "do", why })
    }

    fn listen(&mut self, for_s: f64) -> Result<(), JumperError> {
        let end_s = self.link.socket.time_s() + for_s;
        while self.link.socket.time_s() < end_s {
            self.link.listen(2e-3).map_err(|error| JumperError::Link(error.to_string()))?;
            self.keep();
        }
        Ok(())
    }

    fn records(&mut self) -> Vec<(f64, Record)> {
        std::mem::take(&mut self.records)
    }
}

/// Converters that do not start together disturb each other. That would hide a late converter.
const UNDISTURBED: Errata = Errata { adc_concurrent: false, ..Errata::ALL };

/// A board with jumpers and a planted fault. `None` if there is no image, after reporting the skip.
fn lab(options: Options, prepare: impl FnOnce(&mut Machine)) -> Option<Lab> {
    let mut machine = Machine::with(&shipping_image()?, options, Still).expect("the image");
    machine.chip_mut().jumpers = Some(Jumpers::RIGHT);
    prepare(&mut machine);
    common::run(&mut machine, STARTED_S);
    let mut link = UsbLink::new(machine);
    link.plug_in().expect("opens");
    Some(Lab { link, records: Vec::new() })
}

fn print(report: &Report) {
    for check in &report.checks {
        let verdict = check.cause.as_deref().unwrap_or("ok");
        println!("{:18} {:50} {:50} {verdict}", check.name, check.expected, check.found);
    }
}

#[test]
fn a_sound_board_passes() {
    let Some(mut lab) = lab(Options::default(), |_| {}) else { return };
    let report = lab.run().expect("a test");
    print(&report);
    println!("{:?}", report.measured);
    assert!(report.passed());
    let judged: Vec<_> = report.checks.iter().map(|check| check.name).collect();
    let by_motion =
        ["inertance", "viscous friction", "Coulomb friction", "backlash by the force", "backlash by the terminal"];
    assert!(judged.ends_with(&by_motion), "{judged:?}");
}

/// The test compares the firmware's estimates with the expected device, not with the motion that it plays.
#[test]
fn another_device_than_the_expected_one_fails() {
    let Some(mut lab) = lab(Options::default(), |_| {}) else { return };
    let Inerter { inertance_kg, viscous_n_s_per_m, coulomb_n, .. } = truth();
    let another = Inerter {
        inertance_kg: 1.005 * inertance_kg,
        viscous_n_s_per_m: 1.8 * viscous_n_s_per_m,
        coulomb_n: 1.04 * coulomb_n,
        ..truth()
    };
    let report = run_with(&mut lab, false, another).expect("a test");
    print(&report);
    let failed: Vec<_> = report.checks.iter().filter(|check| !check.passed()).map(|check| check.name).collect();
    assert_eq!(failed, ["inertance", "viscous friction", "Coulomb friction"]);
    assert_eq!(report.measured, None);
}

/// A planted fault, the check that must fail, and words that the reported cause must contain.
struct Case {
    name: &'static str,
    board: Board,
    plant: fn(&mut Machine),
    check: &'static str,
    cause: &'static str,
}

const fn case(name: &'static str, check: &'static str, cause: &'static str, plant: fn(&mut Machine)) -> Case {
    Case { name, board: Board::NUCLEO, plant, check, cause }
}

fn wires(machine: &mut Machine, change: impl FnOnce(&mut Jumpers)) {
    let mut jumpers = Jumpers::RIGHT;
    change(&mut jumpers);
    machine.chip_mut().jumpers = Some(jumpers);
}

/// One microsecond, and half a period of the sampling clock \[cycles\].
const US: u64 = 168;
const HALF: u64 = 2625 / 2;

const CASES: &[Case] = &[
    case("encoder pins swapped", "encoder wires", "A and B are swapped", |machine| {
        wires(machine, |jumpers| std::mem::swap(&mut jumpers.a, &mut jumpers.b));
    }),
    case("analogue pins swapped", "force wire", "force and terminal are swapped", |machine| {
        wires(machine, |jumpers| std::mem::swap(&mut jumpers.force, &mut jumpers.terminal));
    }),
    case("wrong trigger, half a period late", "sampling", "another trigger", |machine| {
        machine.chip_mut().planted.late = [HALF; 2];
    }),
    case("wrong trigger, 1.2 us late", "timing", "a trigger other than", |machine| {
        machine.chip_mut().planted.late = [6 * US / 5; 2];
    }),
    case("ADC1 2 us late", "timing", "the force's converter samples", |machine| {
        machine.chip_mut().planted.late = [2 * US, 0];
    }),
    case("ADC2 2 us late", "timing", "the terminal's converter samples", |machine| {
        machine.chip_mut().planted.late = [0, 2 * US];
    }),
    case("a lost DMA request", "sampling", "a DMA transfer was lost", |machine| {
        machine.chip_mut().planted.lost = Some((Request::Tim6Update, 1.0));
    }),
    case("half the count rate", "encoder wires", "every other edge", |machine| {
        machine.chip_mut().planted.half_counts = true;
    }),
    Case {
        // A crystal 2 % slower than the firmware expects.
        board: Board { hse_hz: 0.98 * Board::NUCLEO.hse_hz, ..Board::NUCLEO },
        ..case("wrong clock", "clock", "2.0 % too slow", |_| {})
    },
    case("force output 5 % off", "force gain", "the wire PA4 to PA0 is loaded", |machine| {
        machine.chip_mut().dac[0].quality = dac::Quality { gain: 1.05, ..dac::Quality::default() };
    }),
    case("terminal output 5 % off", "terminal gain", "the wire PA6 to PA1 is loaded", |machine| {
        machine.chip_mut().dac[1].quality = dac::Quality { gain: 1.05, ..dac::Quality::default() };
    }),
    case("an edge lost in the burst", "fast edges", "edges are lost at the highest rate", |machine| {
        machine.chip_mut().planted.lost_edge = Some(100_000);
    }),
    case("force wire missing", "force wire", "PA4 to PA0 is missing", |machine| {
        wires(machine, |jumpers| jumpers.force = None);
    }),
    case("terminal wire missing", "terminal wire", "PA6 to PA1 is missing", |machine| {
        wires(machine, |jumpers| jumpers.terminal = None);
    }),
    case("A missing", "encoder wires", "A (PB1 to PA15) is missing", |machine| {
        wires(machine, |jumpers| jumpers.a = None);
    }),
    case("B missing", "encoder wires", "B (PB2 to PB3) is missing", |machine| {
        wires(machine, |jumpers| jumpers.b = None);
    }),
    case("A and B missing", "encoder wires", "A (PB1 to PA15) and B (PB2 to PB3) are missing", |machine| {
        wires(machine, |jumpers| (jumpers.a, jumpers.b) = (None, None));
    }),
    case("noise too high", "noise", "noise on the supply", |machine| {
        machine.chip_mut().adc.set_quality(Quality { noise_lsb: 4.0, ..Quality::default() });
    }),
];

/// The delay that a cause names, with its uncertainty \[us\].
fn late_us(cause: &str) -> Option<[f64; 2]> {
    let (late, u95) = cause.split_once(" us too late")?.0.rsplit_once(" +- ")?;
    Some([late.rsplit(' ').next()?.parse().ok()?, u95.parse().ok()?])
}

/// The first check that fails is the one for this fault, and it names the cause; of a late converter also its delay,
/// which is 2 us, between phases that are 0.9 us apart, so within 0.45 us.
#[test]
fn each_planted_fault_is_named() {
    let mut wrong = Vec::new();
    for Case { name, board, plant, check, cause } in CASES {
        let options = Options { board: *board, errata: UNDISTURBED, ..Options::default() };
        let Some(mut lab) = lab(options, plant) else { return };
        let report = match lab.run() {
            Ok(report) => report,
            Err(error) => {
                wrong.push(format!("{name}: {error}"));
                continue;
            }
        };
        let failed = report.checks.iter().find(|check| !check.passed());
        let is_right = |found: &str| {
            let is_sized = late_us(found).is_some_and(|found| found[0] >= 1.55 && found[0] <= 2.45 && found[1] <= 0.45);
            found.contains(cause) && (is_sized || !cause.ends_with("converter samples"))
        };
        let named = failed.is_some_and(|failed| failed.name == *check && failed.cause.as_deref().is_some_and(is_right));
        if !named || report.passed() {
            println!("{name}");
            print(&report);
            wrong.push(format!("{name}: {failed:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The device refuses impossible requests. If the host falls silent, the device stops driving its pins.
#[test]
fn the_outputs_are_let_go_and_nonsense_is_refused() {
    let Some(mut lab) = lab(Options::default(), |_| {}) else { return };
    let mut play = |play: Play| match lab.request(Command::Play(play)) {
        Ok(Done::Played { .. }) => None,
        Err(JumperError::Refused { why, .. }) => Some(why),
        other => panic!("{other:?}"),
    };
    let knots = |advance| Play::Knots([Knot { advance, ..Knot::default() }].into_iter().collect());
    let burst = |edge_ticks| Play::Burst { edge_ticks, blocks: 1 };
    assert_eq!(play(knots(0)), Some(Refusal::NotPlaying));
    assert_eq!(play(Play::Progress), Some(Refusal::NotPlaying));
    assert_eq!(play(burst(28)), Some(Refusal::NotPlaying));
    assert_eq!(play(Play::Begin { phase_ticks: 2625 }), Some(Refusal::BadSamples));
    assert_eq!(play(Play::Begin { phase_ticks: 0 }), None);
    assert_eq!(play(knots(Knot::MAX_ADVANCE + 1)), Some(Refusal::BadSamples));
    assert_eq!(play(knots(i16::MIN)), Some(Refusal::BadSamples));
    for edge_ticks in [0, 1, 23, u16::MAX] {
        assert_eq!(play(burst(edge_ticks)), Some(Refusal::BadSamples), "{edge_ticks}");
    }
    let driven = |lab: &Lab| lab.link.socket.chip().pin_mode(Pin::new('B', 1)) == Mode::Output;
    assert!(driven(&lab));
    lab.listen(0.9).expect("listens");
    assert!(driven(&lab));
    lab.listen(0.2).expect("listens");
    assert!(!driven(&lab), "after a second of silence");
    lab.request(Command::Stop).expect("stops");
    let refused = lab.request(Command::Play(Play::Begin { phase_ticks: 0 }));
    assert!(matches!(refused, Err(JumperError::Refused { why: Refusal::NoSamples, .. })), "{refused:?}");
}

/// Whichever output's DMA transfer fails, the device releases all outputs and reports why.
#[test]
fn outputs_whose_transfers_fail_are_let_go() {
    for channel in 0..3 {
        let breaks = |machine: &mut Machine| machine.chip_mut().dma[1].channels[channel].broken = true;
        let Some(mut lab) = lab(Options::default(), breaks) else { return };
        assert_eq!(lab.run().map(|report| report.checks.len()), Err(JumperError::TransferFailed), "channel {channel}");
    }
}
