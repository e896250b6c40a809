//! The whole test, in order.

use crate::align::{ENTRIES, positions};
use crate::board::{Board, JumperError};
use crate::check::{Check, Judged, Report};
use crate::motion;
use crate::recording::{Recording, record_from_rest};
use crate::sweep::sweep;
use crate::tape::Tape;
use crate::wires::{Chain, Levels, SETTLED_TICKS, chain, played, sampled, sound};
use inerter_core::{Route, Settings};
use inerter_plant::Inerter;
use inerter_wire::{Capabilities, Command, Play, Record, Refusal, SettingsValues, Streams};

/// Ticks from edge to edge of the burst: 6 million counts a second, 1.5 MHz on each line.
const EDGE_TICKS: u16 = 28;
/// Edges of the burst, in units of 256.
const BLOCKS: u16 = 500;
/// Time for the settings to arrive \[s\].
const REPLY_S: f64 = 0.1;

/// Plays, measures and judges; stops at the first check that fails.
///
/// It drives the pins: the caller must have made sure that no rig is connected. The settings in use are restored at the
/// end, whatever happens; saved settings are not touched. `clock_is_known` means that USB's frames have already
/// verified the board's clock. This computer's clock is then not used: packets arrive late, so that it is less
/// accurate.
///
/// # Errors
/// If the test could not be done, which says nothing about the board.
pub fn run(board: &mut impl Board, clock_is_known: bool) -> Result<Report, JumperError> {
    run_with(board, clock_is_known, motion::truth())
}

/// [`run`] with this device played for its parameters; any but [`truth`](motion::truth) must fail.
///
/// # Errors
/// As [`run`].
pub fn run_with(board: &mut impl Board, clock_is_known: bool, device: Inerter) -> Result<Report, JumperError> {
    let before = settings_in_use(board)?;
    let mut report = Report::default();
    let outcome = measure(board, clock_is_known, device, &mut report);
    // Wherever it stopped, the outputs are released; a board that is gone releases them by itself.
    let _ = board.request(Command::Play(Play::End));
    let restored = [Command::WriteSettings(before), Command::ResetEstimator]
        .into_iter()
        .try_for_each(|command| board.request(command).map(drop));
    if let Err(Some(error)) = outcome {
        return Err(error);
    }
    restored.map_err(JumperError::refused("take back its settings"))?;
    Ok(report)
}

fn settings_in_use(board: &mut impl Board) -> Result<SettingsValues, JumperError> {
    board.records();
    board.request(Command::Hello)?;
    board.request(Command::ReadSettings)?;
    board.listen(REPLY_S)?;
    let (mut hello, mut settings) = (None, None);
    for (_, record) in board.records() {
        match record {
            Record::Hello(record) => hello = Some(record),
            Record::Settings(values) => settings = Some(values),
            _ => {}
        }
    }
    if !hello.is_some_and(|hello| hello.capabilities.contains(Capabilities::PLAYER)) {
        return Err(JumperError::Refused { doing: "play", why: Refusal::Unsupported });
    }
    settings.ok_or(JumperError::NoSettings)
}

fn set_up(board: &mut impl Board, settings: &Settings) -> Result<(), JumperError> {
    let streams = Streams { samples: true, estimates: true, health: true, ..Streams::NONE };
    let values = SettingsValues::from(settings);
    for (doing, command) in [
        ("take the test's settings", Command::WriteSettings(values)),
        ("send samples", Command::Streams(streams)),
        ("start sampling", Command::Start),
    ] {
        board.request(command).map_err(JumperError::refused(doing))?;
    }
    board.listen(REPLY_S)
}

fn measure(board: &mut impl Board, clock_is_known: bool, device: Inerter, report: &mut Report) -> Judged<()> {
    set_up(board, &motion::settings(0.0, Route::Force))?;
    let levels = Levels::new();
    let (recording, aligned) = sound(board, &levels.tape, SETTLED_TICKS, None, Report::take, report)?;
    let chain = chain(&levels, &recording, &aligned, report)?;
    let measured = sweep(board, report)?;
    burst(board, report)?;
    motions(board, (&chain, device), measured.skew_s, clock_is_known, report)?;
    report.measured = Some(measured);
    Ok(())
}

/// Plays a device's motion for its parameters, and a worn one's for its backlash, once for each route, which the
/// settings select. All results must agree with what was played.
fn motions(
    board: &mut impl Board,
    (chain, device): (&Chain, Inerter),
    skew_s: f64,
    clock_is_known: bool,
    report: &mut Report,
) -> Judged<()> {
    let mut play = |tape: &Tape, route, report: &mut Report| -> Judged<Recording> {
        set_up(board, &motion::settings(skew_s, route))?;
        let recording = played(record_from_rest(board, tape, SETTLED_TICKS), report)?;
        report.holds(sampled(board, tape, &recording, true)?)?;
        Ok(recording)
    };
    let sound = play(&motion::tape(device, chain)?, Route::Force, report)?;
    if !clock_is_known {
        report.take(motion::timebase(&sound))?;
    }
    motion::parameters(&sound.estimate.unwrap_or_default(), report)?;
    let worn = motion::tape(motion::worn(), chain)?;
    for route in [Route::Force, Route::Terminal] {
        let recording = play(&worn, route, report)?;
        motion::backlash(&recording.detail.unwrap_or_default(), route, report)?;
    }
    Ok(())
}

/// Checks that no edge is lost at the maximum rate.
fn burst(board: &mut impl Board, report: &mut Report) -> Judged<()> {
    let tape = Tape::new();
    let edges = Some((EDGE_TICKS, BLOCKS));
    let (recording, aligned) = sound(board, &tape, SETTLED_TICKS, edges, Report::holds, report)?;
    let positions = positions(&recording);
    // Before the burst, where the tape ends; and after it, before the pins were let go.
    let ended = (tape.steps().len() as i64 - aligned.lag) / ENTRIES as i64 - 1;
    let at = |place: usize| positions.get(place).copied().unwrap_or(0.0);
    let counted = (at(recording.driven.saturating_sub(1)) - at(ended.max(0) as usize)).round();
    let played = f64::from(recording.edges);
    let (wanted, lost) = (f64::from(BLOCKS) * 256.0, played - counted);
    let cause = if played != wanted {
        Some("the burst was not played completely: please report it with this page")
    } else {
        (lost != 0.0).then_some("edges are lost at the highest rate: shorten the wires to A and B")
    };
    let rate = 168.0 / f64::from(EDGE_TICKS);
    let expected = format!("{wanted} counts at {rate} million a second");
    report.take(Check::new("fast edges", expected, format!("{counted} counts of {played} edges"), cause))
}
