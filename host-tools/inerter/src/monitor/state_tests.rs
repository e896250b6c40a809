use inerter_analysis::diagnose::Kind;
use inerter_core::{Estimate, Law, LawStatus};

use super::*;
use crate::monitor::feed::{Moment, Sample};

fn press(state: &mut State, code: KeyCode) -> Option<Action> {
    state.key(KeyEvent::new(code, KeyModifiers::NONE))
}

fn type_letter(state: &mut State, letter: char) -> Option<Action> {
    press(state, KeyCode::Char(letter))
}

fn write(state: &mut State, text: &str) {
    for letter in text.chars() {
        assert_eq!(type_letter(state, letter), None);
    }
}

fn at(run_s: f64) -> Moment {
    Moment { run_s, unix_ns: 0 }
}

fn samples(state: &mut State, run_s: f64) {
    let sample = Sample { at: at(run_s), force_n: 1.0, position_m: 0.0, terminal_m: None };
    state.item(&Item::Samples(vec![sample]));
}

#[test]
fn a_pause_holds_the_view_and_not_the_measurement() {
    let mut state = State::new(None, Vec::new());
    samples(&mut state, 1.0);
    assert_eq!(type_letter(&mut state, ' '), None);
    samples(&mut state, 2.0);
    let estimate = Item::Estimate { at: at(2.0), t_s: 2.0, estimated: Estimate::default().into() };
    state.item(&estimate);
    assert_eq!((state.end_s(), state.shown().estimate, state.now_s), (1.0, None, 2.0));
    type_letter(&mut state, ' ');
    assert_eq!((state.end_s(), state.shown().estimate.is_some()), (2.0, true));
    assert_eq!(state.traces.latest_s(), Some(2.0));
}

#[test]
fn going_back_in_time_pauses_and_stays_within_the_run() {
    let mut state = State::new(None, Vec::new());
    samples(&mut state, 10.0);
    press(&mut state, KeyCode::Left);
    assert_eq!(state.end_s(), 10.0 - 0.25 * state.trace_span_s());
    for _ in 0..100 {
        press(&mut state, KeyCode::Left);
    }
    assert_eq!(state.end_s(), 0.0);
    for _ in 0..100 {
        press(&mut state, KeyCode::Right);
    }
    assert_eq!(state.end_s(), 10.0);
}

#[test]
fn zoom_has_ends_and_belongs_to_the_pane() {
    let mut state = State::new(None, Vec::new());
    let history_s = state.history_span_s();
    for _ in 0..100 {
        type_letter(&mut state, '-');
    }
    assert_eq!((state.trace_span_s(), state.history_span_s()), (1800.0, history_s));
    for _ in 0..100 {
        type_letter(&mut state, '+');
    }
    assert_eq!(state.trace_span_s(), 0.1);
    type_letter(&mut state, '3');
    assert_eq!(state.tab, Tab::Parameters);
    for _ in 0..100 {
        type_letter(&mut state, '-');
    }
    samples(&mut state, 5000.0);
    assert_eq!((state.history_span_s(), state.trace_span_s()), (5000.0, 0.1));
}

#[test]
fn panes_go_round() {
    let mut state = State::default();
    let mut seen = vec![state.tab];
    for _ in 0..Tab::ALL.len() {
        press(&mut state, KeyCode::Tab);
        seen.push(state.tab);
    }
    assert_eq!(seen.first(), seen.last());
    assert!(Tab::ALL.iter().all(|(tab, _)| seen.contains(tab)));
    press(&mut state, KeyCode::BackTab);
    assert_eq!(state.tab, Tab::Events);
    type_letter(&mut state, '9');
    assert_eq!(state.tab, Tab::Events);
}

#[test]
fn a_marker_is_written_letter_by_letter_and_commands_are_letters_then() {
    let mut state = State::default();
    type_letter(&mut state, 'm');
    write(&mut state, "quick r?x");
    press(&mut state, KeyCode::Backspace);
    assert_eq!(state.prompt, Prompt::Marker("quick r?".into()));
    assert_eq!(press(&mut state, KeyCode::Enter), Some(Action::Mark("quick r?".into())));
    assert_eq!(state.prompt, Prompt::None);

    type_letter(&mut state, 'm');
    write(&mut state, "not this");
    assert_eq!(press(&mut state, KeyCode::Esc), None);
    assert_eq!(state.prompt, Prompt::None);
    type_letter(&mut state, 'm');
    assert_eq!(press(&mut state, KeyCode::Enter), Some(Action::Mark("marker".into())));
    type_letter(&mut state, 'm');
    write(&mut state, &"µ".repeat(3 * MARKER_LETTERS));
    let Some(Action::Mark(text)) = press(&mut state, KeyCode::Enter) else { panic!("no marker") };
    assert_eq!(text.chars().count(), MARKER_LETTERS);
}

#[test]
fn a_reset_is_asked_about() {
    let mut state = State::default();
    type_letter(&mut state, 'r');
    assert_eq!((state.prompt.clone(), type_letter(&mut state, 'n')), (Prompt::Reset, None));
    assert_eq!(type_letter(&mut state, 'y'), None, "asked and answered already");
    type_letter(&mut state, 'r');
    assert_eq!(type_letter(&mut state, 'y'), Some(Action::ResetEstimator));
}

#[test]
fn the_ways_out_always_work() {
    for before in [None, Some('?'), Some('m'), Some('r')] {
        let mut state = State::default();
        before.and_then(|key| type_letter(&mut state, key));
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(state.key(interrupt), Some(Action::Quit), "{before:?}");
    }
    assert_eq!(type_letter(&mut State::default(), 'q'), Some(Action::Quit));
    assert_eq!(press(&mut State::default(), KeyCode::Esc), Some(Action::Quit));
    let mut state = State::default();
    type_letter(&mut state, '?');
    assert_eq!((type_letter(&mut state, 'q'), state.prompt), (None, Prompt::None), "closes the list of keys only");
}

#[test]
fn events_and_markers_are_kept_up_to_a_number() {
    let mut state = State::default();
    for number in 0..2 * KEPT {
        let marker = Item::Marker { at: at(number as f64), t_s: None, text: format!("{number}") };
        state.item(&marker);
    }
    assert_eq!((state.lines.len(), state.marks.len()), (KEPT, KEPT));
    for count in 0..50 {
        state.item(&Item::LostFrames(count));
    }
    let lost = state.lines.iter().filter(|line| line.words.contains("lost")).count();
    assert_eq!((lost, state.values.losses.lost_frames), (1, 49), "one line says it");
}

#[test]
fn a_device_that_goes_away_is_told_of_until_it_is_back() {
    let mut state = State::default();
    state.item(&Item::Away { reason: "unplugged".into() });
    assert_eq!(state.away.as_deref(), Some("unplugged"));
    state.item(&Item::Back { port: "COM3".into() });
    assert_eq!(state.away, None);
    let words: Vec<&str> = state.lines.iter().map(|line| line.words.as_str()).collect();
    assert_eq!(words, ["unplugged", "the device is back at COM3"]);
}

#[test]
fn the_strongest_cause_is_shown_while_the_law_does_not_hold() {
    let mut state = State::default();
    let show = |state: &mut State, item: Item| state.item(&item);
    let cause = |kind, f| Cause {
        kind,
        value: 1e-3,
        u95: 1e-5,
        unit: "s",
        f,
        period_m: None,
        is_part_of_a_turn: false,
        rival: None,
    };
    for (kind, f) in [(Kind::Skew, 900.0), (Kind::Drift, 200.0)] {
        show(&mut state, Item::Cause { at: Moment::default(), t_s: 10.0, index: 10_000, cause: cause(kind, f) });
    }
    assert_eq!(state.values.cause.map(|cause| cause.kind), Some(Kind::Skew));
    assert!(state.lines.iter().all(|line| line.kind == LineKind::Trouble) && state.lines.len() == 2);
    for (status, is_shown) in [(LawStatus::Broken, true), (LawStatus::Holds, false)] {
        let estimated = Estimated { law: Some(Law { status, ..Law::default() }), ..Estimated::default() };
        show(&mut state, Item::Estimate { at: Moment::default(), t_s: 11.0, estimated });
        assert_eq!(state.values.cause.is_some(), is_shown);
    }
}
